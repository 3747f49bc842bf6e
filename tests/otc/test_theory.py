"""Eq. 2 in a tabular MDP: what correcting the transition probabilities can do, and cannot."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from otc_dist.otc.prioritization import prioritize

Float = NDArray[np.float64]
STATES = 7


def random_dynamics(seed: int) -> Float:
    """P(s' | s, a) for each of six state-action pairs."""
    return np.random.default_rng(seed).dirichlet(np.ones(STATES), 6)


def kl(p: Float, q: Float) -> Float:
    return np.sum(p * np.log(p / q), axis=-1)


def correct(offline: Float, online: Float, accept: Callable[[Float], Float]) -> tuple[Float, Float]:
    """Corrected P_B and the factor  sum_s^' P_D(s^'|s,a) f(d(s', s^')) / Z(s, a)."""
    places = np.arange(STATES, dtype=float)
    similarity = accept(np.abs(places[:, None] - places[None, :]))  # f(d(s', s^'))
    factor = online @ similarity.T
    unnormalised = offline * factor
    z = unnormalised.sum(-1, keepdims=True)
    return unnormalised / z, factor / z


ACCEPTANCES: list[Callable[[Float], Float]] = [
    lambda d: np.exp(-d),
    lambda d: 1 / (1 + d) ** 2,
    lambda d: (d < 2).astype(float) + 0.01,
    np.ones_like,
]


@pytest.mark.parametrize("accept", ACCEPTANCES)
def test_the_identity_of_eq_2(accept: Callable[[Float], Float]) -> None:
    for seed in range(5):
        offline, online = random_dynamics(seed), random_dynamics(100 + seed)
        corrected, factor = correct(offline, online, accept)
        np.testing.assert_allclose(corrected.sum(-1), 1, rtol=1e-12)
        right = kl(online, offline) - np.sum(online * np.log(factor), axis=-1)
        np.testing.assert_allclose(kl(online, corrected), right, atol=1e-10)


def test_a_constant_acceptance_changes_nothing() -> None:
    offline, online = random_dynamics(1), random_dynamics(2)
    np.testing.assert_allclose(correct(offline, online, np.ones_like)[0], offline, rtol=1e-12)


def sampled_dynamics(offline: Float, online: Float, alpha: float, *, replace: bool) -> Float:
    """P(s') among the transitions that OTC samples, all of one state-action pair.

    So every online transition is a best match, and one of them is drawn uniformly (Eq. 1).
    Next states lie on a line, and d is the distance along it.
    """
    random = np.random.default_rng(0)
    counts = np.zeros(STATES)
    for _ in range(300):
        candidates = random.choice(STATES, 512, p=offline)
        matches = random.choice(STATES, 512, p=online)
        chosen = prioritize(
            torch.from_numpy(np.abs(candidates - matches).astype(float)),
            torch.tensor(alpha).double(),
            torch.from_numpy(random.standard_exponential(512)),
            128,
            with_replacement=replace,
        )
        counts += np.bincount(candidates[chosen.numpy()], minlength=STATES)
    return counts / counts.sum()


# Where the others' policies moved the next states to the right.
OFFLINE = np.array([0.30, 0.25, 0.18, 0.12, 0.08, 0.05, 0.02])
ONLINE = np.array([0.03, 0.06, 0.10, 0.16, 0.20, 0.22, 0.23])


@pytest.mark.parametrize("replace", [True, False])
def test_divergence_falls_where_the_dynamics_differ(replace: bool) -> None:
    before = kl(ONLINE, OFFLINE)
    after = kl(ONLINE, sampled_dynamics(OFFLINE, ONLINE, 1.0, replace=replace))
    uniform = kl(ONLINE, sampled_dynamics(OFFLINE, ONLINE, 0.0, replace=replace))
    assert abs(uniform - before) < 0.02
    assert after < 0.8 * before


def test_divergence_rises_where_the_dynamics_are_the_same() -> None:
    """A known limit of the method: it sharpens towards the mode. Eq. 4, being relative, is blind
    to it."""
    same = np.array([0.02, 0.08, 0.2, 0.4, 0.2, 0.08, 0.02])
    uniform = kl(same, sampled_dynamics(same, same, 0.0, replace=False))
    after = kl(same, sampled_dynamics(same, same, 1.0, replace=False))
    assert uniform < 0.003
    assert 0.01 < after < 0.2
