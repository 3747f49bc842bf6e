"""TD3+BC as pure functions equals a plain TD3+BC of modules, autograd and torch.optim.Adam."""

import numpy as np
import pytest
import torch

from benchmarks.plain.td3bc import PlainTd3Bc
from otc_dist.algorithms.interface import Batch
from otc_dist.algorithms.td3bc import Td3Bc, Td3BcSection
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
DELAYED = {"actor", "actor_moments", "actor_target", "critic_target"}
FROZEN = {"state_mean", "state_std"}


def make(s: int, a: int, hidden: tuple[int, ...]) -> Td3Bc:
    settings = Td3BcSection(
        hidden=hidden,
        actor_learning_rate=3e-4,
        critic_learning_rate=5e-4,
        discount=0.99,
        target_rate=0.05,
        q_weight=2.5,
    )
    return Td3Bc(s, a, settings)


def start(td3bc: Td3Bc, random: np.random.Generator) -> tuple[State, Batch]:
    batch = random_batch(random, td3bc.observation_size, td3bc.action_size, BATCH)
    batch = batch._replace(observation=5 + 3 * batch.observation)
    return double(td3bc.initial_state(random, batch)), batch


@pytest.mark.parametrize(("s", "a", "hidden"), SIZES)
def test_losses_and_weights_equal_the_plain_version_in_float64(
    s: int, a: int, hidden: tuple[int, ...]
) -> None:
    random = np.random.default_rng(0)
    td3bc = make(s, a, hidden)
    state, offline = start(td3bc, random)
    # Other targets than networks, so that a mistaken use of either shows.
    others, _ = start(td3bc, random)
    for name in ("critic", "actor"):
        state[f"{name}_target"] = others[name]
    plain = PlainTd3Bc(td3bc.settings, s, a, torch.float64)
    parts: Parts = {
        "actor": [plain.actor],
        "actor_target": [plain.target_actor],
        "critic": [[plain.critics.first, plain.critics.second]],
        "critic_target": [[plain.target_critics.first, plain.target_critics.second]],
    }
    load(parts, state)
    standard = standardised_alike(state, offline)
    # Noise beyond the clip as well.
    state = assert_equals_plain(td3bc, plain, parts, state, (s, a), standard, spread=3.0)

    states = torch.from_numpy(random.standard_normal((6, s)))
    standardised = standard(states)
    with torch.no_grad():
        actions, values = plain.act(standardised), plain.value(standardised)
    np.testing.assert_allclose(td3bc.act(state, states, {}), actions, atol=1e-10)
    np.testing.assert_allclose(td3bc.value(state, states, {}), values, atol=1e-10)
    np.testing.assert_allclose(td3bc.q(state, states, actions), values, atol=1e-10)


def test_update_leaves_its_arguments_alone_and_passes_on_what_is_not_its_own() -> None:
    td3bc = make(4, 2, (8, 8))
    state, batch = start(td3bc, np.random.default_rng(1))
    state["updates"] += 1  # the actor is due
    assert_pure(td3bc, state, batch, FROZEN)


def test_actor_and_targets_wait_for_every_second_update() -> None:
    random = np.random.default_rng(2)
    td3bc = make(4, 2, (8, 8))
    state, batch = start(td3bc, random)
    for count in range(1, 5):
        noise = first(sample_noise(random, td3bc.noise_spec(BATCH), 1))
        new, metrics = td3bc.update(state, batch, batch, noise)
        unchanged = {name for name in state if torch.equal(new[name], state[name])}
        assert unchanged == (FROZEN if count % 2 == 0 else FROZEN | DELAYED)
        assert (metrics[1] == 0) == (count % 2 == 1)
        state = new


def test_target_at_a_terminal_state_is_the_reward() -> None:
    random = np.random.default_rng(3)
    td3bc = make(4, 2, (8, 8))
    state, batch = start(td3bc, random)
    batch = batch._replace(terminated=torch.ones(BATCH).double())
    noise = first(sample_noise(random, td3bc.noise_spec(BATCH), 1))
    assert torch.equal(td3bc.target(state, batch, noise["target"]), batch.reward)


def test_actions_stay_within_bounds() -> None:
    random = np.random.default_rng(4)
    td3bc = make(4, 2, (8, 8))
    state, batch = start(td3bc, random)
    state["actor"] = state["actor"] * 1000
    assert td3bc.act(state, batch.observation, {}).abs().max() == 1.0


def test_a_constant_observation_is_normalised_to_zero() -> None:
    random = np.random.default_rng(5)
    td3bc = make(4, 2, (8, 8))
    batch = random_batch(random, 4, 2, BATCH)
    batch.observation[:, 1] = 7.0
    state = double(td3bc.initial_state(random, batch))
    assert float(state["state_std"][1]) == pytest.approx(1e-3)
    assert td3bc.act(state, batch.observation, {}).isfinite().all()


@pytest.mark.slow
def test_compiled_agrees_with_eager() -> None:
    assert_engines_agree(make(5, 2, (16, 16)), (5, 2))
