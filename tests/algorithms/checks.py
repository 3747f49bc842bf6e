"""What the tests of several algorithms ask of them."""

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from benchmarks.plain.parts import Plain, normalised, statistics
from otc_dist.algorithms.interface import Algorithm, Batch
from otc_dist.steps.engine import Engine
from otc_dist.steps.noise import sample_noise
from otc_dist.steps.state import P, State, T

from ..flat_weights import Parts, get_flat
from .arrays import first, random_batch

UPDATES, BATCH = 120, 32
FLOAT32_UPDATES = 20  # beyond some tens of updates float32 diverges chaotically


class Batches(Protocol):
    """Makes a random batch."""

    def __call__(self, random: np.random.Generator, s: int, a: int, size: int) -> Batch: ...


def plainly(function: Callable[P, T]) -> Callable[P, T]:
    """A `Fuse` that leaves every function as it is."""
    return function


def assert_equals_plain(
    algorithm: Algorithm,
    plain: Plain,
    parts: Parts,
    state: State,
    sizes: tuple[int, int],
    standard: Callable[[Tensor], Tensor] = lambda states: states,
    spread: float = 1.0,
    batches: Batches = random_batch,
) -> State:
    """Same metrics and weights in float64 for 120 updates from the same batches and noise.

    Args:
        plain: as modules, autograd and torch.optim.Adam; already has the state's weights.
        parts: of the plain version, that the state has as vectors.
        sizes: of an observation and an action.
        standard: what the plain version wants done to states.
        spread: what the noise is multiplied by.

    Returns:
        The state after them.
    """
    random = np.random.default_rng(1)
    for _ in range(UPDATES):
        batch = batches(random, *sizes, BATCH)
        sampled = first(sample_noise(random, algorithm.noise_spec(BATCH), 1))
        noise = {name: spread * tensor for name, tensor in sampled.items()}
        state, metrics = algorithm.update(state, batch, batch, noise)
        expected = plain.update(
            batch._replace(
                observation=standard(batch.observation),
                next_observation=standard(batch.next_observation),
            ),
            noise,
        )
        np.testing.assert_allclose(metrics.numpy(), expected, rtol=1e-10, atol=1e-12)
    assert_same_weights(state, parts)
    assert float(state["updates"]) == UPDATES
    return state


def assert_same_weights(state: State, parts: Parts) -> None:
    for name, held in parts.items():
        np.testing.assert_allclose(state[name], get_flat(held), atol=1e-10, err_msg=name)


def standardised_alike(state: State, offline: Batch) -> Callable[[Tensor], Tensor]:
    """Plain standardisation of states. It finds the same statistics; the state's, rounded to
    float32, become its.
    """
    found = statistics(offline.observation)
    for name, statistic in zip(("state_mean", "state_std"), found, strict=True):
        np.testing.assert_allclose(state[name], statistic, rtol=1e-6)
        state[name] = statistic
    return lambda states: normalised(states, found)


def assert_pure(
    algorithm: Algorithm, state: State, batch: Batch, constant: AbstractSet[str] = frozenset()
) -> None:
    """An update leaves its arguments alone, changes all but `constant`, and passes on the rest."""
    before = {name: tensor.clone() for name, tensor in state.items()}
    other = torch.ones(3)
    noise = first(sample_noise(np.random.default_rng(1), algorithm.noise_spec(BATCH), 1))
    new, _ = algorithm.update({**state, "sampler_weights": other}, batch, batch, noise)
    assert new.pop("sampler_weights") is other
    for name, tensor in before.items():
        assert torch.equal(state[name], tensor), name
        assert torch.equal(new[name], tensor) == (name in constant), name


def assert_engines_agree(
    algorithm: Algorithm, sizes: tuple[int, int], batches: Batches = random_batch
) -> None:
    """Compiled and eager updates have the same metrics, to float32's rounding."""
    random = np.random.default_rng(1)
    inputs = [
        Batch(*(field.float() for field in batches(random, *sizes, BATCH)))
        for _ in range(FLOAT32_UPDATES)
    ]
    sampled = sample_noise(random, algorithm.noise_spec(BATCH), len(inputs))
    initial = algorithm.initial_state(random, inputs[0])
    metrics = []
    # Compiled first: what an eager update would prepare may not compile.
    for engine in (Engine("compiled", "own"), Engine("eager")):
        state: State = {name: torch.from_numpy(array) for name, array in initial.items()}
        update, history = engine.fuse(algorithm.update), []
        for index, batch in enumerate(inputs):
            noise = {name: torch.from_numpy(array[index]) for name, array in sampled.items()}
            state, values = update(state, batch, batch, noise)
            history.append(values)
        metrics.append(torch.stack(history).numpy())
    np.testing.assert_allclose(metrics[0], metrics[1], rtol=2e-4, atol=2e-5)
