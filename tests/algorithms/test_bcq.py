"""BCQ as pure functions equals a plain BCQ of modules, autograd and torch.optim.Adam."""

import numpy as np
import pytest
import torch

from benchmarks.plain.bcq import PlainBcq
from otc_dist.algorithms.bcq import Bcq, BcqSection
from otc_dist.steps.noise import sample_noise

from ..flat_weights import Parts, load
from .arrays import double, first, random_batch
from .checks import BATCH, assert_equals_plain

SIZES = [(11, 1, (64, 64)), (17, 3, (24, 16, 8))]
CANDIDATES = 5


def make(s: int, a: int, hidden: tuple[int, ...]) -> Bcq:
    settings = BcqSection(
        hidden=hidden,
        actor_learning_rate=3e-4,
        critic_learning_rate=5e-4,
        vae_learning_rate=1e-3,
        discount=0.99,
        target_rate=0.05,
        target_candidates=CANDIDATES,
        acting_candidates=20,
        perturbation=0.05,
        soft_minimum=0.75,
    )
    return Bcq(s, a, settings)


@pytest.mark.parametrize(("s", "a", "hidden"), SIZES)
def test_losses_and_weights_equal_the_plain_version_in_float64(
    s: int, a: int, hidden: tuple[int, ...]
) -> None:
    random = np.random.default_rng(0)
    bcq = make(s, a, hidden)
    state = double(bcq.initial_state(random, random_batch(random, s, a, BATCH)))
    # Other targets than networks, so that a mistaken use of either shows.
    for name in ("critic", "actor"):
        other = bcq.initial_state(random, random_batch(random, s, a, BATCH))
        state[f"{name}_target"] = double(other)[name]
    plain = PlainBcq(bcq.settings, s, a, torch.float64)
    parts: Parts = {
        "vae": [plain.encoder, plain.decoder],
        "actor": [plain.actor],
        "actor_target": [plain.target_actor],
        "critic": [[plain.critics.first, plain.critics.second]],
        "critic_target": [[plain.target_critics.first, plain.target_critics.second]],
    }
    load(parts, state)
    state = assert_equals_plain(bcq, plain, parts, state, (s, a))

    states = torch.from_numpy(random.standard_normal((6, s)))
    specs = {**bcq.acting_noise_spec(6), **bcq.value_noise_spec(6, 4)}
    noise = first(sample_noise(random, specs, 1))
    with torch.no_grad():
        actions, values = plain.act(states, noise["act"]), plain.value(states, noise["value"])
    np.testing.assert_allclose(bcq.act(state, states, noise), actions, atol=1e-10)
    np.testing.assert_allclose(bcq.value(state, states, noise), values, atol=1e-10)


def test_update_leaves_its_arguments_alone() -> None:
    random = np.random.default_rng(1)
    bcq = make(4, 2, (8, 8))
    state = double(bcq.initial_state(random, random_batch(random, 4, 2, BATCH)))
    before = {name: tensor.clone() for name, tensor in state.items()}
    batch = random_batch(random, 4, 2, BATCH)
    new, _ = bcq.update(state, batch, batch, first(sample_noise(random, bcq.noise_spec(BATCH), 1)))
    for name, tensor in before.items():
        assert torch.equal(state[name], tensor), name
        assert not torch.equal(new[name], tensor), name


def test_target_at_a_terminal_state_is_the_reward() -> None:
    random = np.random.default_rng(2)
    bcq = make(4, 2, (8, 8))
    state = double(bcq.initial_state(random, random_batch(random, 4, 2, BATCH)))
    batch = random_batch(random, 4, 2, BATCH)._replace(terminated=torch.ones(BATCH).double())
    noise = first(sample_noise(random, bcq.noise_spec(BATCH), 1))
    assert torch.equal(bcq.target(state, batch, noise["target"]), batch.reward)


def test_actions_stay_within_bounds() -> None:
    random = np.random.default_rng(3)
    bcq = make(4, 2, (8, 8))
    state = double(bcq.initial_state(random, random_batch(random, 4, 2, BATCH)))
    state["vae"] = state["vae"] * 50  # saturates the decoder
    state["actor"] = state["actor"] * 50
    states = torch.from_numpy(random.standard_normal((64, 4)))
    actions = bcq.act(state, states, first(sample_noise(random, bcq.acting_noise_spec(64), 1)))
    assert actions.abs().max() == 1.0
