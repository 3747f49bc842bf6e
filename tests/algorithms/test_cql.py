"""CQL as pure functions equals a plain CQL of modules, autograd and torch.optim.Adam."""

import math

import numpy as np
import pytest
import torch

from otc_dist.algorithms.cql import Cql
from otc_dist.algorithms.draws import draw
from otc_dist.algorithms.interface import Batch, State
from otc_dist.engine import Engine

from .. import references_cql
from .arrays import double, first, random_batch

SIZES = [(11, 1, (64, 64)), (17, 3, (24, 16, 8))]
UPDATES, BATCH = 120, 32


def make(s: int, a: int, hidden: tuple[int, ...]) -> Cql:
    return Cql(
        observation_size=s,
        action_size=a,
        hidden=hidden,
        actor_learning_rate=3e-4,
        critic_learning_rate=5e-4,
        discount=0.99,
        target_rate=0.05,
        weight=5.0,
        action_samples=6,
    )


def start(cql: Cql, random: np.random.Generator) -> tuple[State, Batch]:
    batch = random_batch(random, cql.observation_size, cql.action_size, BATCH)
    return double(cql.initial_state(random, batch)), batch


@pytest.mark.parametrize(("s", "a", "hidden"), SIZES)
def test_losses_and_weights_equal_the_plain_version_in_float64(
    s: int, a: int, hidden: tuple[int, ...]
) -> None:
    random = np.random.default_rng(0)
    cql = make(s, a, hidden)
    state, _ = start(cql, random)
    # Another target than the network, so that a mistaken use of either shows.
    state["critic_target"] = start(cql, random)[0]["critic"]
    plain = references_cql.Cql(
        s, a, hidden, actor_rate=3e-4, critic_rate=5e-4, tau=0.05, weight=5.0
    )
    plain.load(state)
    for _ in range(UPDATES):
        batch = random_batch(random, s, a, BATCH)
        noise = first(draw(random, cql.noise(BATCH), 1))
        state, metrics = cql.update(state, batch, noise)
        expected = plain.update(batch, noise)
        np.testing.assert_allclose(metrics.numpy(), expected, rtol=1e-10, atol=1e-12)
    for name, weights in plain.weights().items():
        np.testing.assert_allclose(state[name].numpy(), weights.numpy(), atol=1e-10, err_msg=name)
    assert float(state["updates"]) == UPDATES

    states = torch.from_numpy(random.standard_normal((6, s)))
    noise = first(draw(random, cql.value_noise(6, 4), 1))
    with torch.no_grad():
        actions, values = plain.act(states), plain.value(states, noise["value"])
    np.testing.assert_allclose(cql.act(state, states, {}), actions, atol=1e-10)
    np.testing.assert_allclose(cql.value(state, states, noise), values, atol=1e-10)


def test_update_leaves_its_arguments_alone_and_passes_on_what_is_not_its_own() -> None:
    random = np.random.default_rng(1)
    cql = make(4, 2, (8, 8))
    state, batch = start(cql, random)
    before = {name: tensor.clone() for name, tensor in state.items()}
    other = torch.ones(3)
    noise = first(draw(random, cql.noise(BATCH), 1))
    new, _ = cql.update({**state, "sampler_weights": other}, batch, noise)
    assert new.pop("sampler_weights") is other
    for name, tensor in before.items():
        assert torch.equal(state[name], tensor), name
        assert not torch.equal(new[name], tensor), name


def test_target_at_a_terminal_state_is_the_reward() -> None:
    random = np.random.default_rng(2)
    cql = make(4, 2, (8, 8))
    state, batch = start(cql, random)
    batch = batch._replace(terminated=torch.ones(BATCH).double())
    noise = first(draw(random, cql.noise(BATCH), 1))
    there = cql.policy(state["actor"], batch.next_observation)
    assert torch.equal(cql.target(state, batch, there, noise["target"]), batch.reward)


def test_conservative_term_is_the_log_of_the_integral_where_q_is_flat() -> None:
    """Q = 0 everywhere: each importance-corrected sample estimates the volume of the actions."""
    random = np.random.default_rng(3)
    cql = make(4, 1, (8, 8))
    state, batch = start(cql, random)
    here = (torch.full((BATCH, 1), 0.1).double(), torch.full((BATCH, 1), -0.2).double())
    noise = {
        name: torch.from_numpy(random.random((BATCH, 4000, 1)))
        if name == "random"
        else torch.from_numpy(random.standard_normal((BATCH, 4000, 1)))
        for name in ("random", "current", "next")
    }
    actions, log_density = cql.candidates(here, here, noise)
    flat = torch.zeros_like(state["critic"])
    loss = cql.critic_loss(flat, batch, torch.zeros(BATCH).double(), actions, log_density)
    expected = 2 * cql.weight * math.log(12000 * 2.0)
    assert float(loss) == pytest.approx(expected, rel=1e-3)


def test_actions_stay_within_bounds_and_densities_stay_finite_where_tanh_saturates() -> None:
    random = np.random.default_rng(4)
    cql = make(4, 2, (8, 8))
    state, batch = start(cql, random)
    state["actor"] = state["actor"] * 1000
    assert cql.act(state, batch.observation, {}).abs().max() == 1.0
    _, metrics = cql.update(state, batch, first(draw(random, cql.noise(BATCH), 1)))
    assert metrics.isfinite().all()


@pytest.mark.slow
def test_compiled_agrees_with_eager() -> None:
    random = np.random.default_rng(5)
    cql = make(5, 2, (16, 16))
    batches = [
        Batch(*(field.float() for field in random_batch(random, 5, 2, BATCH))) for _ in range(20)
    ]
    draws = draw(random, cql.noise(BATCH), len(batches))
    arrays = cql.initial_state(random, batches[0])
    metrics = {}
    for engine in (Engine("eager"), Engine("compiled")):
        state: State = {name: torch.from_numpy(array) for name, array in arrays.items()}
        update, history = engine.fuse(cql.update), []
        for index, batch in enumerate(batches):
            noise = {name: torch.from_numpy(array[index]) for name, array in draws.items()}
            state, values = update(state, batch, noise)
            history.append(values)
        metrics[engine.name] = torch.stack(history).numpy()
    np.testing.assert_allclose(metrics["compiled"], metrics["eager"], rtol=2e-4, atol=2e-5)
