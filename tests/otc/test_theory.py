"""The paper's theory in tabular tasks: what correcting the transition probabilities can do, and
cannot, by the equations and by Algorithm 1's own sampling."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from .tabular import (
    DISTANCE,
    GAMMA,
    OFFLINE,
    ONLINE,
    STATES,
    Float,
    Sets,
    corrected,
    frequencies,
    kl,
    optimal_values,
    random_team,
    rank_acceptance,
    sampled_dynamics,
    seen_by_one,
    weighted_dynamics,
)

METHOD = Path(__file__).parents[2] / "docs" / "method.md"
ACCEPTANCES = {
    "exponential": np.exp(-3 * DISTANCE / DISTANCE.max()),
    "power": 1 / (1 + DISTANCE) ** 2,
    "step": (DISTANCE < 0.5) + 0.01,
    "constant": np.ones_like(DISTANCE),
}


@pytest.mark.parametrize("name", ACCEPTANCES)
def test_the_identity_of_eq_2(name: str) -> None:
    """KL(P_D || modified P_B) = KL(P_D || P_B) - sum_s' P_D log(factor), for every (s, a)."""
    random = np.random.default_rng(0)
    for _ in range(50):
        team = random.dirichlet(np.ones(STATES), (STATES, 3, 3))
        offline, online = (
            seen_by_one(team, random.dirichlet(np.ones(3), STATES)) for _ in range(2)
        )
        modified, factor = corrected(offline, online, ACCEPTANCES[name])
        np.testing.assert_allclose(modified.sum(-1), 1, atol=1e-12)
        right = kl(online, offline) - np.sum(online * np.log(factor), axis=-1)
        np.testing.assert_allclose(kl(online, modified), right, atol=1e-10)


def test_a_constant_acceptance_changes_nothing() -> None:
    modified, _ = corrected(OFFLINE, ONLINE, ACCEPTANCES["constant"])
    np.testing.assert_allclose(modified, OFFLINE, rtol=1e-12)


@pytest.mark.parametrize("name", ["exponential", "power", "step"])
def test_correction_brings_the_dynamics_and_the_values_nearer(name: str) -> None:
    modified, _ = corrected(OFFLINE, ONLINE, ACCEPTANCES[name])
    assert kl(ONLINE, modified).mean() < 0.8 * kl(ONLINE, OFFLINE).mean()
    rewards = np.tile(np.arange(STATES)[:, None] / STATES, (1, 3))
    v_online, v_offline, v_modified = (
        optimal_values(dynamics, rewards, GAMMA) for dynamics in (ONLINE, OFFLINE, modified)
    )
    assert np.abs(v_modified - v_online).max() < 0.8 * np.abs(v_offline - v_online).max()


@cache
def measured(case: str) -> dict[str, float]:
    """KL(P_D || .) as a mean over (s, a): of P_B, and of what alpha = 1 makes of it."""
    sets = Sets.sample({"differ": OFFLINE, "the same": ONLINE}[case], ONLINE)
    offline = frequencies(sets.rows)
    exact, _ = corrected(offline, ONLINE, rank_acceptance(offline, ONLINE, 1.0))
    found = {
        "P_B": offline,
        "uniform": sampled_dynamics(sets, 0.0, replace=False),
        "sampled": sampled_dynamics(sets, 1.0, replace=False),
        "with replacement": sampled_dynamics(sets, 1.0, replace=True),
        "exactly": exact,
        "share": weighted_dynamics(sets, "share"),
        "conformal": weighted_dynamics(sets, "conformal"),
    }
    return {name: float(kl(ONLINE, dynamics).mean()) for name, dynamics in found.items()}


def test_algorithm_1_lowers_the_divergence_where_the_dynamics_differ() -> None:
    found = measured("differ")
    assert found["uniform"] == pytest.approx(found["P_B"], abs=0.01)
    for way in ("sampled", "with replacement", "exactly"):
        assert found[way] < 0.7 * found["P_B"], way


def test_algorithm_1_raises_the_divergence_where_the_dynamics_are_the_same() -> None:
    """A known limit: it sharpens. Eq. 4, being relative, is blind to it."""
    found = measured("the same")
    assert found["uniform"] == pytest.approx(found["P_B"], abs=0.01)
    for way in ("sampled", "with replacement", "exactly"):
        assert found["P_B"] + 0.01 < found[way] < 0.2, way


def test_conformal_acceptance_does_no_harm_where_the_dynamics_are_the_same() -> None:
    assert measured("the same")["conformal"] < 0.005
    assert measured("differ")["conformal"] < measured("differ")["P_B"]


@pytest.mark.parametrize("case", ["differ", "the same"])
def test_what_algorithm_1_samples_is_the_modified_p_b(case: str) -> None:
    """With replacement Eq. 3 is the acceptance f, up to the chance of a finite minibatch."""
    found = measured(case)
    assert found["with replacement"] == pytest.approx(found["exactly"], abs=0.02)


@pytest.mark.parametrize("case", ["differ", "the same"])
def test_the_documentation_states_what_is_measured_here(case: str) -> None:
    row = re.search(rf"^\| {case} \|(.*)\|$", METHOD.read_text(), re.MULTILINE)
    assert row is not None
    stated = [float(cell) for cell in row[1].split("|")]
    found = measured(case)
    ways = ("P_B", "sampled", "with replacement", "exactly", "share", "conformal")
    expected = [found[way] for way in ways]
    np.testing.assert_allclose(stated, expected, atol=0.006)


def test_the_bound_of_theorem_1() -> None:
    """|V_1* - V_2*| <= gamma r_max / (1 - gamma)^2 |P_1 - P_2|_1 on random teams, where two
    policies of the partner make P_1 and P_2."""
    random = np.random.default_rng(0)
    for _ in range(400):
        team, gamma = random_team(random), float(random.choice([0.5, 0.9, 0.99]))
        rewards = random.normal(size=(5, 3)) * random.choice([0.1, 1.0, 10.0])
        one, other = random.dirichlet(np.full(3, 0.3), (2, 5))
        other += random.choice([0.0, 0.5, 0.99]) * (one - other)  # from unlike to nearly alike
        first, second = seen_by_one(team, one), seen_by_one(team, other)
        gap = difference(first, second, rewards, gamma)
        assert 0 < gap <= theorem_1(first, second, rewards, gamma) + 1e-9


def test_the_bound_of_theorem_1_is_sharp() -> None:
    """Staying in a good state for ever, and leaving it for a bad one with a small chance."""
    gamma, chance, rewards = 0.9, 1e-4, np.array([[1.0], [-1.0]])
    stay = np.array([[[1.0, 0.0]], [[0.0, 1.0]]])
    leave = np.array([[[1 - chance, chance]], [[0.0, 1.0]]])
    gap, bound = (f(stay, leave, rewards, gamma) for f in (difference, theorem_1))
    assert 0.999 * bound < gap <= bound


def difference(first: Float, second: Float, rewards: Float, gamma: float) -> float:
    values = [optimal_values(dynamics, rewards, gamma) for dynamics in (first, second)]
    return float(np.abs(values[0] - values[1]).max())


def theorem_1(first: Float, second: Float, rewards: Float, gamma: float) -> float:
    apart = np.abs(first - second).sum(-1).max()
    return float(gamma * np.abs(rewards).max() / (1 - gamma) ** 2 * apart)
