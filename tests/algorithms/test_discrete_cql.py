"""Discrete CQL as pure functions equals a plain version of modules and masks."""

import math

import numpy as np
import pytest
import torch

from benchmarks.plain.discrete_cql import PlainDiscreteCql
from otc_dist.algorithms.discrete_cql import DiscreteCql, DiscreteCqlSection
from otc_dist.algorithms.interface import Batch
from otc_dist.steps.state import State

from ..flat_weights import Parts, load
from .arrays import double, random_choices
from .checks import BATCH, assert_engines_agree, assert_equals_plain, assert_pure

SIZES = [(12, 5, (64, 64)), (9, 3, (24, 16, 8))]


def make(s: int, choices: int, hidden: tuple[int, ...]) -> DiscreteCql:
    settings = DiscreteCqlSection(
        hidden=hidden,
        critic_learning_rate=5e-4,
        discount=0.99,
        target_rate=0.05,
        weight=1.5,
    )
    return DiscreteCql(s, choices, settings)


def start(cql: DiscreteCql, random: np.random.Generator) -> tuple[State, Batch]:
    batch = random_choices(random, cql.observation_size, cql.action_size, BATCH)
    return double(cql.initial_state(random, batch)), batch


@pytest.mark.parametrize(("s", "choices", "hidden"), SIZES)
def test_losses_and_weights_equal_the_plain_version_in_float64(
    s: int, choices: int, hidden: tuple[int, ...]
) -> None:
    random = np.random.default_rng(0)
    cql = make(s, choices, hidden)
    state, batch = start(cql, random)
    # Another target than the network, so that a mistaken use of either shows.
    state["critic_target"] = start(cql, random)[0]["critic"]
    plain = PlainDiscreteCql(cql.settings, s, choices, torch.float64)
    parts: Parts = {"critic": [plain.critic], "critic_target": [plain.target_critic]}
    load(parts, state)
    state = assert_equals_plain(cql, plain, parts, state, (s, choices), batches=random_choices)

    states = batch.observation
    with torch.no_grad():
        actions, values = plain.act(states), plain.value(states)
    np.testing.assert_array_equal(cql.act(state, states, {}), actions)
    np.testing.assert_allclose(cql.value(state, states, {}), values, atol=1e-10)
    np.testing.assert_allclose(cql.q(state, states, actions), values, atol=1e-10)


def test_update_leaves_its_arguments_alone_and_passes_on_what_is_not_its_own() -> None:
    cql = make(7, 3, (8, 8))
    assert_pure(cql, *start(cql, np.random.default_rng(1)))


def test_target_at_a_terminal_state_is_the_reward() -> None:
    cql = make(7, 3, (8, 8))
    state, batch = start(cql, np.random.default_rng(2))
    batch = batch._replace(terminated=torch.ones(BATCH).double())
    assert torch.equal(cql.target(state, batch), batch.reward)


def test_an_unavailable_action_with_a_huge_value_changes_nothing() -> None:
    random = np.random.default_rng(3)
    cql, huge = make(9, 4, (8, 8)), 2
    state, batch = start(cql, random)
    for states in (batch.observation, batch.next_observation):
        states[:, 5 + huge] = 0.0
        states[:, 5] = 1.0  # one at least is available
    batch.action[batch.action == huge] = 0.0
    tempting = {name: tensor.clone() for name, tensor in state.items()}
    for name in ("critic", "critic_target"):
        tempting[name][huge - 4] += 1e6  # the last layer's bias
    found, wanted = ({}, {})
    for outcome, begin in ((found, tempting), (wanted, state)):
        outcome["target"] = cql.target(begin, batch)
        outcome["loss"] = cql.critic_loss(begin["critic"], batch, outcome["target"])
        outcome["action"] = cql.act(begin, batch.observation, {})
        outcome["value"] = cql.value(begin, batch.observation, {})
        outcome["critic"] = cql.update(begin, batch, batch, {})[0]["critic"] - begin["critic"]
    for name, tensor in wanted.items():
        torch.testing.assert_close(found[name], tensor, rtol=0, atol=1e-9, msg=name)
    assert huge not in found["action"]


def test_conservative_term_counts_the_available_actions_where_q_is_flat() -> None:
    cql = make(7, 3, (8, 8))
    state, batch = start(cql, np.random.default_rng(4))
    flat = torch.zeros_like(state["critic"])
    loss = cql.critic_loss(flat, batch, torch.zeros(BATCH).double())
    counts = batch.observation[:, -3:].sum(1)
    assert float(loss) == pytest.approx(1.5 * float(counts.log().mean()))


def test_a_large_error_pulls_no_harder_than_an_error_of_one() -> None:
    """Huber's loss, the weight of the conservative term apart."""
    cql = make(7, 3, (8, 8))
    state, batch = start(cql, np.random.default_rng(5))
    flat = torch.zeros_like(state["critic"])
    losses = [
        float(cql.critic_loss(flat, batch, torch.full((BATCH,), y).double())) for y in (0.0, 1, 9)
    ]
    assert losses[1] - losses[0] == pytest.approx(0.5)
    assert losses[2] - losses[0] == pytest.approx(8.5)


def test_no_available_action_at_a_terminal_state_spoils_nothing() -> None:
    cql = make(7, 3, (8, 8))
    state, batch = start(cql, np.random.default_rng(6))
    dead = batch.next_observation.clone()
    dead[:, -3:] = 0.0
    batch = batch._replace(next_observation=dead, terminated=torch.ones(BATCH).double())
    new, metrics = cql.update(state, batch, batch, {})
    assert torch.equal(cql.target(state, batch), batch.reward)
    assert all(tensor.isfinite().all() for tensor in [metrics, *new.values()])
    assert cql.value(state, dead, {}).isfinite().all()
    assert math.isfinite(float(cql.q(state, dead, cql.act(state, dead, {})).sum()))


@pytest.mark.slow
def test_compiled_agrees_with_eager() -> None:
    assert_engines_agree(make(8, 3, (16, 16)), (8, 3), random_choices)
