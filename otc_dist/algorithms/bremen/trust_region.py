"""Trust region policy optimization (TRPO: Schulman et al., ICML 2015): one step as a function.

    maximise  L(theta) = E[pi_theta(a|s) / pi_old(a|s) A(s, a)]   subject to   E[KL] <= delta

The natural gradient is found by conjugate gradients on Fisher-vector products, scaled to the
radius delta, and shortened until the step improves L and stays within delta (their Appendix C).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor


# As in BREMEN's code.
DAMPING = 0.1  # added to the Fisher matrix's diagonal
ITERATIONS = 10  # of conjugate gradients
LENGTHS = 10  # of the step, tried from the full one down
ACCEPTED_SHARE = 0.1  # of the gain that the gradient promises: a step with less is too long
CONVERGED = 1e-10  # squared residual at which conjugate gradients stay where they are
# Not as there, where each length is half of the one before and the divergence is not checked: a
# full step exceeds the radius by a few percent about every other time, and would lose half.
SHORTENING = 0.8

Product = Callable[["Tensor"], "Tensor"]  # v -> A v (n,)


class Step(NamedTuple):
    """Where a step led. All but `parameters` are scalars, and zero if no length was accepted."""

    parameters: Tensor  # (n,)
    length: Tensor  # 1 for the full step, 0.8, 0.64, ...
    gain: Tensor  # L(theta) - L(theta_old)
    divergence: Tensor  # E[KL(pi_old || pi_theta)]


def trust_region_step(
    parameters: Tensor,
    gradient: Tensor,
    outcome: Callable[[Tensor], tuple[Tensor, Tensor]],
    fisher: Product,
    radius: float,
) -> Step:
    """One step from theta_old.

    Args:
        parameters: theta_old (n,).
        gradient: of L at theta_old (n,).
        outcome: L(theta) - L(theta_old) and E[KL(pi_old || pi_theta)], for the line search.
        fisher: v -> F v, F the Hessian of E[KL(pi_old || pi_theta)] at theta_old, perhaps over
            fewer states.
        radius: delta, nats.

    Returns:
        The longest step that is within the radius and has more than ACCEPTED_SHARE of the gain
        that the gradient promises; theta_old if there is none.
    """

    def damped(vector: Tensor) -> Tensor:
        return fisher(vector) + DAMPING * vector

    direction = conjugate_gradient(damped, gradient)
    curvature = direction @ damped(direction)
    # Without a gradient there is no direction: a step of length zero, not of NaN.
    scale = torch.where(curvature > 0, (2 * radius / curvature).sqrt(), 0)
    full = scale * direction
    promised = gradient @ full

    length = torch.ones_like(promised)
    for _ in range(LENGTHS):
        candidate = parameters + length * full
        gained, diverged = outcome(candidate)
        if gained > ACCEPTED_SHARE * length * promised and diverged <= radius:
            return Step(candidate, length, gained, diverged)
        length = SHORTENING * length
    nothing = torch.zeros_like(promised)
    return Step(parameters, nothing, nothing, nothing)


def gauss_newton_product(
    function: Callable[[Tensor], Tensor], parameters: Tensor, vector: Tensor
) -> Tensor:
    """J^T J v (n,), J the Jacobian of `function` at `parameters` (n,).

    Of the means of normal distributions of one fixed deviation, this over its square is the
    Hessian of their KL divergence where they are equal, without second derivatives.
    """
    change: Tensor = torch.func.jvp(function, (parameters,), (vector,))[1]
    product: Tensor = torch.func.vjp(function, parameters)[1](change)[0]
    return product


def conjugate_gradient(product: Product, target: Tensor) -> Tensor:
    """x (n,) with A x = b nearly, for a positive definite A given by its products.

    Residuals are kept orthogonal to all before them. In exact arithmetic they are; in float32
    rounding errors grow a hundredfold an iteration, and the tenth is off by a third.
    """
    solution, residual, direction = torch.zeros_like(target), target, target
    square = residual @ residual
    basis: list[Tensor] = []
    for _ in range(ITERATIONS):
        image = product(direction)
        size = torch.where(square > CONVERGED, square / (direction @ image), 0)
        solution = solution + size * direction
        basis.append(torch.where(square > CONVERGED, residual / square.sqrt(), 0))
        residual = residual - size * image
        for unit in basis:
            residual = residual - (unit @ residual) * unit
        before, square = square, residual @ residual
        direction = residual + torch.where(before > CONVERGED, square / before, 0) * direction
    return solution
