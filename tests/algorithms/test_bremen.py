"""BREMEN as pure functions equals a plain BREMEN of modules, autograd and torch.optim.Adam."""

from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.plain.bremen import PlainBremen
from otc_dist.algorithms.bremen.advantages import generalised_advantages
from otc_dist.algorithms.bremen.algorithm import Bremen, BremenSection
from otc_dist.algorithms.interface import Batch, unpack
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import sample_noise
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

from ..brains import silent
from ..flat_weights import Parts, load
from .arrays import double, first, random_batch
from .checks import (
    BATCH,
    assert_engines_agree,
    assert_equals_plain,
    assert_pure,
    assert_same_weights,
    plainly,
)
from .every import online, pretrained

SIZES = [(11, 1, (64, 64)), (17, 3, (24, 16, 8))]
SMALL_SIZES = [(5, 1, (16, 16)), (7, 3, (12, 8))]
IMPROVED = {"policy", "value", "value_moments", "value_updates"}  # by an improvement, nothing else
STATISTICS = {
    f"{name}_{of}" for name in ("observation", "action", "change") for of in ("mean", "std")
}


class Bounded:
    """Some task: forward costs effort, and ends where the first entry leaves an interval."""

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        return next_observation[..., 0] + observation[..., 1] - 0.1 * (action * action).sum(-1)

    def terminated(self, next_observation: Any) -> Any:
        return abs(next_observation[..., 0]) > 1.0


class Endless(Bounded):
    def terminated(self, next_observation: Any) -> Any:
        return next_observation[..., 0] > np.inf


def make(
    s: int, a: int, hidden: tuple[int, ...], task: Bounded | None = None, **settings: Any
) -> Bremen:
    usual: dict[str, Any] = {
        "actor_learning_rate": 3e-4,
        "model_learning_rate": 5e-4,
        "average_rate": 0.02,
        "discount": 0.99,
        "models": 5,
        "improvements": 3,
        "horizon": 7,
        "std": 0.1,
        "trace": 0.95,
        "radius": 0.05,
    }
    section = BremenSection(hidden=hidden, **{**usual, **settings})
    return Bremen(s, a, section, task or Bounded())


def start(bremen: Bremen, random: np.random.Generator) -> tuple[State, Batch]:
    batch = random_batch(random, bremen.observation_size, bremen.action_size, BATCH)
    return double(bremen.initial_state(random, batch)), batch


def taught(bremen: Bremen, random: np.random.Generator) -> tuple[State, Batch]:
    """After 300 updates on  s' = s + (a, a)."""
    batch = random_batch(random, 2, 1, 256)
    batch = batch._replace(next_observation=batch.observation + batch.action)
    state = double(bremen.initial_state(random, batch))
    for _ in range(300):
        state, _ = bremen.update(state, batch, batch, {})
    return state, batch


def improved(bremen: Bremen, state: State, batch: Batch, seed: int) -> tuple[State, torch.Tensor]:
    specs = bremen.improvement_noise_spec(len(batch.observation))
    noise = first(sample_noise(np.random.default_rng(seed), specs, 1))
    with torch.no_grad():
        return bremen.improve(plainly, state, batch, noise)


def plain_of(bremen: Bremen, state: State, offline: Batch) -> tuple[PlainBremen, Parts]:
    """The plain version with the same weights; the state's statistics become the plain ones,
    since its own are rounded to float32.
    """
    sizes = bremen.observation_size, bremen.action_size
    plain = PlainBremen(bremen.settings, *sizes, bremen.task, torch.float64)
    parts: Parts = {
        "models": [[*plain.models]],
        "clone": [plain.clone],
        "policy": [plain.policy],
        "value": [plain.values],
        "models_average": [[*plain.average_models]],
        "clone_average": [plain.average_clone],
    }
    load(parts, state)
    plain.fit_statistics(offline)
    statistics = {
        f"{name}_{of}": statistic
        for name, found in plain.statistics.items()
        for of, statistic in zip(("mean", "std"), found, strict=True)
    }
    assert statistics.keys() == STATISTICS
    for name, statistic in statistics.items():
        np.testing.assert_allclose(state[name], statistic, rtol=1e-6, atol=1e-7)
        state[name] = statistic
    np.testing.assert_allclose(state["value_scale"], plain.value_scale, rtol=1e-6)
    state["value_scale"] = plain.value_scale
    return plain, parts


@pytest.mark.parametrize(("s", "a", "hidden"), SIZES)
def test_losses_and_weights_equal_the_plain_version_in_float64(
    s: int, a: int, hidden: tuple[int, ...]
) -> None:
    bremen = make(s, a, hidden)
    state, offline = start(bremen, np.random.default_rng(0))
    plain, parts = plain_of(bremen, state, offline)
    assert_equals_plain(bremen, plain, parts, state, (s, a))


@pytest.mark.parametrize(("s", "a", "hidden"), SMALL_SIZES)
def test_improvements_equal_the_plain_version_in_float64(
    s: int, a: int, hidden: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "otc_dist.algorithms.bremen.policy_step.PART", 60
    )  # of 7 x 32: with a remainder
    bremen = make(s, a, hidden)
    random = np.random.default_rng(1)
    state, offline = start(bremen, random)
    # Another average than the weights, so that a mistaken use of either shows.
    state["models_average"] = 1.1 * state["models_average"]
    plain, parts = plain_of(bremen, state, offline)
    for _ in range(3):
        batch = random_batch(random, s, a, BATCH)
        noise = first(sample_noise(random, bremen.improvement_noise_spec(BATCH), 1))
        with torch.no_grad():
            state, metrics = bremen.improve(plainly, state, batch, noise)
        expected = plain.improve(batch.observation, noise)
        ends, length = expected[1], expected[-1]
        assert 0 < ends < 1 and length > 0  # episodes end, and a step is taken
        np.testing.assert_allclose(metrics.numpy(), expected, rtol=1e-10)
        assert_same_weights(state, parts)
    states = torch.from_numpy(random.standard_normal((6, s)))
    with torch.no_grad():
        actions = plain.act(states)
        cloned = plain.clone(plain.normal("observation", states)).tanh()
    np.testing.assert_allclose(bremen.act(state, states, {}), actions, atol=1e-10)
    assert not torch.allclose(actions, cloned, atol=1e-2)


def test_update_leaves_its_arguments_alone_and_passes_on_what_is_not_its_own() -> None:
    bremen = make(4, 2, (8, 8))
    state, batch = start(bremen, np.random.default_rng(1))
    assert_pure(bremen, state, batch, IMPROVED | STATISTICS | {"value_scale"})


def test_improvement_leaves_its_arguments_alone_and_changes_policy_and_value_only() -> None:
    bremen = make(4, 2, (8, 8))
    state, batch = start(bremen, np.random.default_rng(2))
    before = {name: tensor.clone() for name, tensor in state.items()}
    new, metrics = improved(bremen, state, batch, seed=0)
    again, same = improved(bremen, state, batch, seed=0)
    assert torch.equal(metrics, same)
    for name, tensor in before.items():
        assert torch.equal(state[name], tensor), name
        assert torch.equal(new[name], again[name]), name
        assert torch.equal(new[name], tensor) == (name not in IMPROVED), name


def test_averages_reach_back_over_a_tenth_of_the_updates_and_then_no_further() -> None:
    bremen = make(4, 2, (8, 8), average_rate=1e-3)
    state, _ = start(bremen, np.random.default_rng(11))
    weights = []
    for count in (1, 101, 10_000, 1_000_000):
        state["updates"] = torch.tensor(float(count)).double()
        state["clone"] = torch.zeros_like(state["clone"])
        state["clone_average"] = torch.ones_like(state["clone"])
        weights.append(1 - float(bremen.average(state, "clone")[0]))
    assert weights == pytest.approx([1, 1 / 11, 1e-3, 1e-3], rel=1e-3)


def test_the_first_policy_is_the_clone() -> None:
    bremen = make(4, 2, (8, 8))
    state, batch = start(bremen, np.random.default_rng(3))
    for _ in range(2):
        state, _ = bremen.update(state, batch, batch, {})
    state, _ = improved(bremen, state, batch, seed=0)
    begun = bremen.first_policy(state)
    assert not torch.equal(begun["policy"], state["policy"])
    assert torch.equal(begun["policy"], state["clone_average"])
    assert not torch.equal(begun["policy"], state["clone"])
    assert {name for name in state if begun[name] is not state[name]} == {"policy"}


def test_tuning_improves_the_deployed_policy() -> None:
    """The offline policy starts from the clone; without a step tuning leaves it as it is."""
    learner = pretrained("bremen", "algorithm.improvements=0")
    offline = learner.policy[1]
    assert torch.equal(offline["policy"], offline["clone_average"])
    learner.tune(1, online("bremen", 1), silent)
    tuned = learner.policy[1]
    assert torch.equal(tuned["policy"], offline["policy"])
    assert not torch.equal(tuned["models"], offline["models"])
    assert not torch.equal(tuned["clone_average"], offline["clone_average"])


def test_steps_stay_within_the_radius() -> None:
    bremen = make(4, 2, (16, 16), radius=0.02)
    state, batch = start(bremen, np.random.default_rng(4))
    names = bremen.improvement_metric_names
    for seed in range(10):
        new, metrics = improved(bremen, state, batch, seed)
        found = dict(zip(names, metrics.tolist(), strict=True))
        assert 0 < found["divergence"] <= 0.02
        assert found["gain"] > 0
        state = new


def test_improvements_raise_the_reward_in_the_models() -> None:
    bremen = make(2, 1, (16, 16), task=Endless(), horizon=20, model_learning_rate=1e-2)
    random = np.random.default_rng(5)
    state, batch = taught(bremen, random)
    state = bremen.first_policy(state)
    judged = first(sample_noise(random, bremen.improvement_noise_spec(len(batch.action)), 1))
    before = bremen.rollouts(plainly, state, batch, judged).rewards.mean()
    for seed in range(20):
        state, _ = improved(bremen, state, batch, seed)
    assert bremen.rollouts(plainly, state, batch, judged).rewards.mean() > before + 1.0


def test_where_a_rollout_ends_another_starts_from_a_state_of_the_batch() -> None:
    bremen = make(4, 2, (8, 8), horizon=20)
    state, batch = start(bremen, np.random.default_rng(6))
    noise = first(sample_noise(np.random.default_rng(0), bremen.improvement_noise_spec(BATCH), 1))
    rollouts = bremen.rollouts(plainly, state, batch, noise)
    following = torch.cat((rollouts.observations[1:], rollouts.last.unsqueeze(0)))
    ended = rollouts.ends.bool()
    assert ended.any() and not ended.all()
    starts = {tuple(s.tolist()) for s in batch.observation}
    assert torch.equal(rollouts.observations[0], batch.observation)
    assert all(tuple(s.tolist()) in starts for s in following[ended])
    assert not any(tuple(s.tolist()) in starts for s in following[~ended])
    assert not Bounded().terminated(rollouts.observations[1:][~ended[:-1]]).any()


def test_what_comes_after_an_end_counts_for_nothing_before_it() -> None:
    random = np.random.default_rng(7)
    rewards, ends = torch.from_numpy(random.standard_normal((6, 2))), torch.zeros(6, 2).double()
    values = torch.from_numpy(random.standard_normal((7, 2)))
    ends[2, 0] = 1
    found = generalised_advantages(rewards, ends, values, 0.99, 0.95)
    changed_rewards, changed_values = rewards.clone(), values.clone()
    changed_rewards[3:], changed_values[3:] = 10, 10
    other = generalised_advantages(changed_rewards, ends, changed_values, 0.99, 0.95)
    assert torch.equal(found[:3, 0], other[:3, 0])
    assert not torch.isclose(found[:3, 1], other[:3, 1]).any()
    assert found[2, 0] == rewards[2, 0] - values[2, 0]


def test_task_and_models_see_actions_within_bounds() -> None:
    class Watching(Bounded):
        largest = 0.0

        def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
            self.largest = max(self.largest, float(action.abs().max()))
            return super().reward(observation, action, next_observation)

    task = Watching()
    bremen = make(4, 2, (8, 8), task=task, std=3.0)
    state, batch = start(bremen, np.random.default_rng(8))
    improved(bremen, state, batch, seed=0)
    assert task.largest == 1.0


def test_models_learn_the_dynamics_and_differ_by_their_weights() -> None:
    bremen = make(2, 1, (16, 16), models=2, model_learning_rate=1e-2)
    state, batch = taught(bremen, np.random.default_rng(9))
    models = bremen.ensemble.network.apart(state["models_average"])
    predicted = [
        bremen.ensemble.predict(model, state, batch.observation, batch.action) for model in models
    ]
    for prediction in predicted:
        error = (prediction - batch.next_observation) / state["change_std"]
        assert (error**2).mean() < 0.01
    assert not torch.equal(predicted[0], predicted[1])


def test_diverging_models_stay_finite() -> None:
    bremen = make(4, 2, (8, 8), task=Endless(), horizon=60)
    state, batch = start(bremen, np.random.default_rng(10))
    state["models_average"] = 1e6 * state["models_average"]
    new, metrics = improved(bremen, state, batch, seed=0)
    assert metrics.isfinite().all()
    assert all(tensor.isfinite().all() for tensor in new.values())


@pytest.mark.slow
def test_compiled_agrees_with_eager() -> None:
    assert_engines_agree(make(5, 2, (16, 16)), (5, 2))


@pytest.mark.slow
def test_compiled_improvements_agree_with_eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """With those of double precision: in single precision three steps of one engine drift apart."""
    monkeypatch.setattr(
        "otc_dist.algorithms.bremen.policy_step.PART", 60
    )  # of 7 x 32: with a remainder
    bremen = make(4, 2, (8, 8), task=Endless())
    state, batch = start(bremen, np.random.default_rng(12))
    found = []
    single = Engine("compiled", "own")
    for engine, dtype in ((single, torch.float32), (Engine("eager"), torch.float64)):
        improving = {n: x if "updates" in n else x.to(dtype) for n, x in state.items()}
        # A learner's batch is views of packed rows.
        packed = torch.cat([x.reshape(BATCH, -1).to(dtype) for x in batch], 1)
        rows, history = unpack(packed, RowLayout(4, 2)), []
        for seed in range(3):
            specs = bremen.improvement_noise_spec(BATCH)
            noise = first(sample_noise(np.random.default_rng(seed), specs, 1))
            noise = {name: tensor.to(dtype) for name, tensor in noise.items()}
            with torch.no_grad():
                improving, metrics = bremen.improve(engine.fuse, improving, rows, noise)
            history.append(metrics)
        metrics = torch.stack(history)
        assert (metrics[:, -1] > 0).all()  # steps are taken
        found.append([metrics, improving["policy"], improving["value"]])
    for compiled, eager in zip(*found, strict=True):
        np.testing.assert_allclose(compiled, eager, rtol=1e-3, atol=1e-5)
