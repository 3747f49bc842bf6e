"""CQL as pure functions equals a plain CQL of modules, autograd and torch.optim.Adam."""

import math

import numpy as np
import pytest
import torch

from benchmarks.plain.cql import PlainCql
from otc_dist.algorithms.cql import Cql, CqlSection
from otc_dist.algorithms.interface import Batch
from otc_dist.steps.noise import sample_noise
from otc_dist.steps.state import State

from ..flat_weights import Parts, load
from .arrays import double, first, random_batch
from .checks import (
    BATCH,
    assert_engines_agree,
    assert_equals_plain,
    assert_pure,
    standardised_alike,
)

SIZES = [(11, 1, (64, 64)), (17, 3, (24, 16, 8))]
FROZEN = {"state_mean", "state_std"}


def make(s: int, a: int, hidden: tuple[int, ...]) -> Cql:
    settings = CqlSection(
        hidden=hidden,
        actor_learning_rate=3e-4,
        critic_learning_rate=5e-4,
        discount=0.99,
        target_rate=0.05,
        weight=5.0,
        action_samples=6,
    )
    return Cql(s, a, settings)


def start(cql: Cql, random: np.random.Generator) -> tuple[State, Batch]:
    batch = random_batch(random, cql.observation_size, cql.action_size, BATCH)
    return double(cql.initial_state(random, batch)), batch


@pytest.mark.parametrize(("s", "a", "hidden"), SIZES)
def test_losses_and_weights_equal_the_plain_version_in_float64(
    s: int, a: int, hidden: tuple[int, ...]
) -> None:
    random = np.random.default_rng(0)
    cql = make(s, a, hidden)
    state, offline = start(cql, random)
    # Another target than the network, so that a mistaken use of either shows.
    state["critic_target"] = start(cql, random)[0]["critic"]
    plain = PlainCql(cql.settings, s, a, torch.float64)
    parts: Parts = {
        "actor": [plain.actor],
        "critic": [[plain.critics.first, plain.critics.second]],
        "critic_target": [[plain.target_critics.first, plain.target_critics.second]],
        "log_temperature": [plain.log_temperature],
    }
    load(parts, state)
    standard = standardised_alike(state, offline)
    state = assert_equals_plain(cql, plain, parts, state, (s, a), standard)

    states = torch.from_numpy(random.standard_normal((6, s)))
    standardised = standard(states)
    noise = first(sample_noise(random, cql.value_noise_spec(6, 4), 1))
    with torch.no_grad():
        actions, values = plain.act(standardised), plain.value(standardised, noise["value"])
    np.testing.assert_allclose(cql.act(state, states, {}), actions, atol=1e-10)
    np.testing.assert_allclose(cql.value(state, states, noise), values, atol=1e-10)
    with torch.no_grad():
        judged = plain.critics.one(standardised, actions)
    np.testing.assert_allclose(cql.q(state, states, actions), judged, atol=1e-10)


def test_update_leaves_its_arguments_alone_and_passes_on_what_is_not_its_own() -> None:
    cql = make(4, 2, (8, 8))
    assert_pure(cql, *start(cql, np.random.default_rng(1)), FROZEN)


def test_target_at_a_terminal_state_is_the_reward() -> None:
    random = np.random.default_rng(2)
    cql = make(4, 2, (8, 8))
    state, batch = start(cql, random)
    batch = batch._replace(terminated=torch.ones(BATCH).double())
    noise = first(sample_noise(random, cql.noise_spec(BATCH), 1))
    there = cql.policy(state["actor"], batch.next_observation)
    assert torch.equal(cql.target(state, batch, there, noise["target"]), batch.reward)


def test_candidates_weigh_alike_where_q_is_flat() -> None:
    """Each of the 3n corrected samples then estimates the volume of the actions, here 2."""
    random = np.random.default_rng(3)
    cql, n = make(4, 1, (8, 8)), 4000
    state, batch = start(cql, random)
    here, there = ((torch.full((BATCH, 1), x).double(),) * 2 for x in (0.1, -0.5))
    noise = {
        "random": torch.from_numpy(random.random((BATCH, n, 1))),
        "current": torch.from_numpy(random.standard_normal((BATCH, n, 1))),
        "next": torch.from_numpy(random.standard_normal((BATCH, n, 1))),
    }
    actions, log_density = cql.candidates(here, there, noise)
    means = (-log_density).exp().view(BATCH, 3, n).mean((0, 2))
    np.testing.assert_allclose(means, 2.0, rtol=0.02)
    flat = torch.zeros_like(state["critic"])
    loss = cql.critic_loss(flat, batch, torch.zeros(BATCH).double(), actions, log_density)
    assert float(loss) == pytest.approx(2 * cql.settings.weight * math.log(3 * n * 2.0), rel=1e-3)


def test_actions_stay_within_bounds_and_densities_finite_where_tanh_saturates() -> None:
    random = np.random.default_rng(4)
    cql = make(4, 2, (8, 8))
    state, batch = start(cql, random)
    state["actor"] = state["actor"] * 1000
    assert cql.act(state, batch.observation, {}).abs().max() == 1.0
    _, metrics = cql.update(
        state, batch, batch, first(sample_noise(random, cql.noise_spec(BATCH), 1))
    )
    assert metrics.isfinite().all()


@pytest.mark.slow
def test_compiled_agrees_with_eager() -> None:
    assert_engines_agree(make(5, 2, (16, 16)), (5, 2))
