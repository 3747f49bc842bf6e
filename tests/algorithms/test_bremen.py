"""BREMEN as pure functions equals a plain BREMEN of modules, autograd and torch.optim.Adam."""

import numpy as np
import pytest
import torch

from benchmarks.plain.bremen import PlainBremen
from otc_dist.algorithms.bremen.algorithm import Bremen
from otc_dist.algorithms.interface import Batch, unpack
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import sample_noise
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

from ..flat_weights import Parts, load
from .arrays import first, random_batch
from .bremens import Endless, improved, make, start
from .checks import (
    BATCH,
    assert_engines_agree,
    assert_equals_plain,
    assert_pure,
    assert_same_weights,
    plainly,
)

SIZES = [(11, 1, (64, 64)), (17, 3, (24, 16, 8))]
SMALL_SIZES = [(5, 1, (16, 16)), (7, 3, (12, 8))]
IMPROVED = {"policy", "value", "value_moments", "value_updates"}  # by an improvement, nothing else
STATISTICS = {
    f"{name}_{of}" for name in ("observation", "action", "change") for of in ("mean", "std")
}


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
