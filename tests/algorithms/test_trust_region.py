"""One step of TRPO: against plain arithmetic where that can be exact, and within its radius."""

import numpy as np
import pytest
import torch
from torch import Tensor

from otc_dist.algorithms.bremen.trust_region import (
    Step,
    conjugate_gradient,
    gauss_newton_product,
    trust_region_step,
)

SIZE = 6  # so that ten iterations of conjugate gradients are exact


def matrix(random: np.random.Generator, size: int = SIZE) -> Tensor:
    """Positive definite."""
    root = random.standard_normal((size, size))
    return torch.from_numpy(root @ root.T + np.eye(size))


class Problem:
    """Gain g^T x + c |x|^3 and divergence x^T F x / 2 (+ e |x|^4), x the way from theta_old."""

    def __init__(self, seed: int, curvature: float = 0.0, excess: float = 0.0) -> None:
        random = np.random.default_rng(seed)
        self.start = torch.from_numpy(random.standard_normal(SIZE))
        self.gradient = torch.from_numpy(random.standard_normal(SIZE))
        self.fisher = matrix(random)
        self.curvature, self.excess = curvature, excess

    def gain(self, parameters: Tensor) -> Tensor:
        x = parameters - self.start
        return self.gradient @ x + self.curvature * (x @ x) ** 1.5

    def divergence(self, parameters: Tensor) -> Tensor:
        x = parameters - self.start
        return x @ self.fisher @ x / 2 + self.excess * (x @ x) ** 2

    def step(self, radius: float) -> Step:
        def outcome(parameters: Tensor) -> tuple[Tensor, Tensor]:
            return self.gain(parameters), self.divergence(parameters)

        with torch.no_grad():
            return trust_region_step(
                self.start, self.gradient, outcome, lambda vector: self.fisher @ vector, radius
            )

    def expected(self, radius: float) -> np.ndarray:
        """The same with a solver, and a line search that tries one length after another."""
        damped = self.fisher.numpy() + 0.1 * np.eye(SIZE)
        g = self.gradient.numpy()
        direction = np.linalg.solve(damped, g)
        full = np.sqrt(2 * radius / (direction @ damped @ direction)) * direction
        for length in 0.8 ** np.arange(10):
            candidate = self.start + torch.from_numpy(length * full)
            gain, divergence = float(self.gain(candidate)), float(self.divergence(candidate))
            if gain > 0.1 * length * (g @ full) and divergence <= radius:
                return np.asarray(candidate)
        return np.asarray(self.start)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("curvature", "excess", "shortened"), [(0, 0, False), (-20.0, 0, True), (0, 40.0, True)]
)
def test_step_is_the_damped_natural_gradient_as_long_as_it_may_be(
    seed: int, curvature: float, excess: float, shortened: bool
) -> None:
    problem = Problem(seed, curvature, excess)
    step = problem.step(radius=0.2)
    np.testing.assert_allclose(step.parameters, problem.expected(0.2), rtol=1e-9)
    assert 0 < step.divergence <= 0.2
    assert step.gain > 0
    assert (step.length < 1) == shortened
    assert step.gain == problem.gain(step.parameters)
    assert step.divergence == problem.divergence(step.parameters)


@pytest.mark.parametrize("problem", [Problem(0, curvature=-1e6), Problem(0, excess=1e9)])
def test_a_line_search_that_finds_nothing_leaves_the_policy_as_it_is(problem: Problem) -> None:
    step = problem.step(radius=0.2)
    assert torch.equal(step.parameters, problem.start)
    assert (step.length, step.gain, step.divergence) == (0, 0, 0)


def test_without_a_gradient_there_is_no_step() -> None:
    problem = Problem(1)
    problem.gradient = torch.zeros_like(problem.gradient)
    step = problem.step(radius=0.2)
    assert torch.equal(step.parameters, problem.start)
    assert step.length == 0


def test_step_leaves_its_arguments_alone_and_is_the_same_again() -> None:
    problem = Problem(2)
    before = problem.start.clone()
    first, again = problem.step(0.2), problem.step(0.2)
    assert torch.equal(problem.start, before)
    assert torch.equal(first.parameters, again.parameters)


def test_gauss_newton_product() -> None:
    random = np.random.default_rng(3)
    jacobian = torch.from_numpy(random.standard_normal((4, SIZE)))
    x, v = (torch.from_numpy(random.standard_normal(SIZE)) for _ in range(2))
    # J is diag(2 J x) J at x.
    product = gauss_newton_product(lambda x: (jacobian @ x) ** 2, x, v)
    expected = jacobian.T @ (4 * (jacobian @ x) ** 2 * (jacobian @ v))
    np.testing.assert_allclose(product, expected, rtol=1e-12)


def test_conjugate_gradient_solves_what_ten_iterations_can() -> None:
    random = np.random.default_rng(4)
    for size in (1, 4, 10):
        a, b = matrix(random, size), torch.from_numpy(random.standard_normal(size))
        solution = conjugate_gradient(lambda v, a=a: a @ v, b)
        np.testing.assert_allclose(a @ solution, b, atol=1e-5)


def test_conjugate_gradient_is_as_exact_in_float32_as_float32() -> None:
    """Without keeping the residuals orthogonal it is off by a sixth here."""
    random = np.random.default_rng(5)
    roots = torch.from_numpy(random.standard_normal((60, 200)) / np.arange(1, 61)[:, None])
    a = 100 * roots.T @ roots + 0.1 * torch.eye(200).double()
    b = roots.T @ torch.from_numpy(random.standard_normal(60))
    exact = conjugate_gradient(lambda v: a @ v, b)
    rounded = conjugate_gradient(lambda v: a.float() @ v, b.float())
    assert (rounded - exact).norm() < 1e-4 * exact.norm()


def test_conjugate_gradient_stays_where_it_has_converged() -> None:
    b = torch.arange(1.0, 5.0, dtype=torch.float64)
    solution = conjugate_gradient(lambda v: 2 * v, b)  # exact after one iteration
    np.testing.assert_allclose(solution, b / 2, rtol=1e-12)
    assert torch.equal(conjugate_gradient(lambda v: v, 0 * b), 0 * b)
