"""AWAC as pure functions equals a plain AWAC of modules, autograd and torch.optim.Adam."""

import math
from typing import Literal

import numpy as np
import pytest
import torch

from benchmarks.plain.awac import PlainAwac
from otc_dist.algorithms.awac import Awac, AwacSection
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
Weighting = Literal["softmax", "exponential"]


def make(
    s: int,
    a: int,
    hidden: tuple[int, ...],
    weighting: Weighting = "softmax",
    temperature: float = 2.0,
) -> Awac:
    settings = AwacSection(
        hidden=hidden,
        actor_learning_rate=3e-4,
        critic_learning_rate=5e-4,
        discount=0.99,
        target_rate=0.05,
        weighting=weighting,
        temperature=temperature,
    )
    return Awac(s, a, settings)


def start(awac: Awac, random: np.random.Generator) -> tuple[State, Batch]:
    batch = random_batch(random, awac.observation_size, awac.action_size, BATCH)
    return double(awac.initial_state(random, batch)), batch


@pytest.mark.parametrize(("s", "a", "hidden"), SIZES)
@pytest.mark.parametrize(("weighting", "temperature"), [("softmax", 0.3), ("exponential", 0.05)])
def test_losses_and_weights_equal_the_plain_version_in_float64(
    s: int, a: int, hidden: tuple[int, ...], weighting: Weighting, temperature: float
) -> None:
    random = np.random.default_rng(0)
    awac = make(s, a, hidden, weighting, temperature)
    state, offline = start(awac, random)
    # Another target than the network, so that a mistaken use of either shows.
    state["critic_target"] = start(awac, random)[0]["critic"]
    state["actor"][-a:] = torch.linspace(1, 3, a)  # samples beyond the bounds
    plain = PlainAwac(awac.settings, s, a, torch.float64)
    parts: Parts = {
        "actor": [plain.actor, plain.log_std_logits],
        "critic": [[plain.critics.first, plain.critics.second]],
        "critic_target": [[plain.target_critics.first, plain.target_critics.second]],
    }
    load(parts, state)
    standard = standardised_alike(state, offline)
    state = assert_equals_plain(awac, plain, parts, state, (s, a), standard)

    states = torch.from_numpy(random.standard_normal((6, s)))
    standardised = standard(states)
    noise = first(sample_noise(random, awac.value_noise_spec(6, 4), 1))
    with torch.no_grad():
        actions, values = plain.act(standardised), plain.value(standardised, noise["value"])
    np.testing.assert_allclose(awac.act(state, states, {}), actions, atol=1e-10)
    np.testing.assert_allclose(awac.value(state, states, noise), values, atol=1e-10)
    with torch.no_grad():
        judged = plain.critics.one(standardised, actions)
    np.testing.assert_allclose(awac.q(state, states, actions), judged, atol=1e-10)


def test_update_leaves_its_arguments_alone_and_passes_on_what_is_not_its_own() -> None:
    awac = make(4, 2, (8, 8))
    assert_pure(awac, *start(awac, np.random.default_rng(1)), {"state_mean", "state_std"})


def test_target_at_a_terminal_state_is_the_reward() -> None:
    random = np.random.default_rng(2)
    awac = make(4, 2, (8, 8))
    state, batch = start(awac, random)
    batch = batch._replace(terminated=torch.ones(BATCH).double())
    noise = first(sample_noise(random, awac.noise_spec(BATCH), 1))
    assert torch.equal(awac.target(state, batch, noise["target"]), batch.reward)


def test_softmax_weights_average_one_and_know_only_differences() -> None:
    advantages = torch.tensor([0.0, 2 * math.log(3), -1000.0, 0.0]).double()
    weights = make(4, 2, (8, 8)).weights(advantages)
    torch.testing.assert_close(weights, torch.tensor([0.8, 2.4, 0.0, 0.8]).double())
    torch.testing.assert_close(make(4, 2, (8, 8)).weights(advantages + 300), weights)


def test_exponential_weights_are_bounded() -> None:
    awac = make(4, 2, (8, 8), "exponential", 0.5)
    weights = awac.weights(torch.tensor([0.0, 1.0, 1000.0, -1000.0]).double())
    torch.testing.assert_close(weights, torch.tensor([1.0, math.e**2, 100.0, 0.0]).double())


def test_actions_and_deviations_stay_within_bounds() -> None:
    random = np.random.default_rng(3)
    awac = make(4, 2, (8, 8))
    state, batch = start(awac, random)
    for scale in (1000, -1000):
        actor = state["actor"] * 1000
        actor[-2:] = scale
        std = awac.policy(actor, batch.observation)[1].exp()
        assert std.tolist() == pytest.approx([1.0 if scale > 0 else math.exp(-6)] * 2)
        noise = torch.from_numpy(random.standard_normal((BATCH, 2)))
        assert awac.sample(actor, batch.observation, noise).abs().max() == 1.0
        assert awac.act({**state, "actor": actor}, batch.observation, {}).abs().max() == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("weighting", ["softmax", "exponential"])
def test_compiled_agrees_with_eager(weighting: Weighting) -> None:
    assert_engines_agree(make(5, 2, (16, 16), weighting), (5, 2))
