"""A base algorithm fed by a sampler: what one phase of training does, and its random numbers."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from otc_dist.algorithms.interface import Algorithm, Improving, unpack
from otc_dist.otc.data import Data
from otc_dist.otc.samplers.interface import Extent, Sampler
from otc_dist.steps.engine import Engine, Update
from otc_dist.steps.noise import Noise, NoiseSpec, sample_noise
from otc_dist.steps.stacking import each
from otc_dist.steps.state import State
from otc_dist.steps.training import BLOCK, SampleBlock, train
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import RowLayout

Step = Callable[[State, Tensor, Tensor, Noise], tuple[State, Tensor]]
OnBlock = Callable[[State, int, dict[str, float]], None]


class Phase(NamedTuple):
    """What the random numbers of a phase are keyed by."""

    purpose: str  # "offline" or "tuning"
    deployment: int
    minibatch_key: int


class Work(NamedTuple):
    """What a phase's updates begin with, learn from, and are called.

    Attributes:
        span: the updates [start, stop) that are left.
    """

    state: State
    data: Data
    extent: Extent
    phase: Phase
    span: tuple[int, int]


@dataclass(frozen=True)
class Progress:
    """Where training stands. Reported every 100 updates, the same in every run of a seed."""

    phase: str  # "offline", what the distance fits ("embedding", "dynamics"), or "tuning"
    deployment: int  # 0 while offline
    update: int
    updates: int
    metrics: dict[str, float]  # means since the last report; tuning's first: what was measured


Report = Callable[[Progress], None]


class Trainer:
    """Trains by one algorithm on the minibatches of one sampler.

    Args:
        step: the algorithm's update on packed rows, for values and to imitate, as the engine
            runs it.
        random: a stream for a key.

    Attributes:
        metric_names: of the values that an update gives: the algorithm's and the sampler's.
        device: where it trains.
    """

    def __init__(
        self,
        algorithm: Algorithm,
        sampler: Sampler,
        step: Step,
        layout: RowLayout,
        batch_size: int,
        engine: Engine,
        random: Callable[..., np.random.Generator],
    ) -> None:
        self._algorithm, self._sampler, self._step = algorithm, sampler, step
        self._layout = layout
        self._batch_size, self._engine, self._random = batch_size, engine, random
        self._select = engine.fuse(sampler.select) if sampler.computes else sampler.select
        self.metric_names = (*algorithm.metric_names, *sampler.metric_names)
        self.device = engine.device

    def train(self, work: Work, on_block: OnBlock) -> State:
        """The updates of `work.span`, then the algorithm's improvement steps.

        Args:
            on_block: called after each block of updates, and after each improvement, with the
                state, how many of both are done, and the block's mean metrics by name.

        Raises:
            UserError: a metric is not finite: training has diverged.
        """

        def on_updates(state: State, done: int, metrics: list[float]) -> None:
            if np.shape(metrics) != (count := len(self.metric_names),):
                raise ValueError(
                    f"an update has to give {count} metrics ({', '.join(self.metric_names)}), not"
                    f" the shape {np.shape(metrics)}"
                )
            named = dict(zip(self.metric_names, metrics, strict=True))
            check_finite(work.phase, done, named.items())
            on_block(state, done, named)

        update, sample_block = self._engine.record(self._update(work.data)), self.sampling(work)
        state = train(work.state, update, sample_block, self.device, work.span, BLOCK, on_updates)
        if isinstance(self._algorithm, Improving):
            state = self._improve(self._algorithm, work._replace(state=state), on_block)
        return state

    def sampling(self, work: Work) -> SampleBlock:
        """The numbers that the updates of `work` take, block by block."""
        specs = self._algorithm.noise_spec(self._batch_size)
        return self._sampling(specs, work.extent, work.phase, "")

    def stacked_update(self, data: Data) -> Update:
        """An update of several states at once, as the engine runs it, from stacked numbers.

        It gives the algorithm's metrics only, one state's (S * m,) after another's. The sampler
        must be one that learns nothing.
        """
        step = _fused_stacked_update(self._engine, self._algorithm, self._layout)

        def choose(state: State, sampled: Noise) -> tuple[Tensor, ...]:
            rows, imitated, *_ = self._choose(data, state, sampled)
            return (rows,) if imitated is rows else (rows, imitated)

        def update(state: State, sampled: Noise) -> tuple[State, Tensor]:
            chosen = each(choose)(state, sampled)
            state, metrics = step(state, chosen[0], chosen[-1], sampled)
            return state, metrics.flatten()

        return self._engine.record(update)

    def _improve(self, algorithm: Improving, work: Work, on_block: OnBlock) -> State:
        def improve(state: State, sampled: Noise) -> tuple[State, Tensor]:
            rows, _, _, state = self._choose(work.data, state, sampled)
            return algorithm.improve(self._engine.fuse, state, unpack(rows, self._layout), sampled)

        def on_improvement(state: State, done: int, metrics: list[float]) -> None:
            names = algorithm.improvement_metric_names
            on_block(state, work.span[1] + done, dict(zip(names, metrics, strict=True)))

        specs = algorithm.improvement_noise_spec(self._batch_size)
        sample_block = self._sampling(specs, work.extent, work.phase, "-improvement")
        span = (0, algorithm.improvements)
        with torch.no_grad():
            offline = work.phase.purpose == "offline"  # tuning goes on from the deployed policy
            state = algorithm.first_policy(work.state) if offline else work.state
            return train(state, improve, sample_block, self.device, span, 1, on_improvement)

    def _update(self, data: Data) -> Update:
        """One update on rows that the sampler chooses; the choice's metrics join the update's."""

        def update(state: State, sampled: Noise) -> tuple[State, Tensor]:
            rows, imitated, more, state = self._choose(data, state, sampled)
            # Without the sampler's entries: the step is compiled once, whatever the sampler.
            own = {name: x for name, x in state.items() if not name.startswith("sampler_")}
            new, metrics = self._step(own, rows, imitated, sampled)
            return {**state, **new}, metrics if more is None else torch.cat((metrics, more))

        return update

    def _choose(
        self, data: Data, state: State, sampled: Noise
    ) -> tuple[Tensor, Tensor, Tensor | None, State]:
        gathered = self._sampler.gather(state, data, sampled)
        chosen = self._select(state, gathered, sampled)
        rows = data.rows.index_select(0, chosen.rows)
        same = chosen.imitated is chosen.rows
        imitated = rows if same else data.rows.index_select(0, chosen.imitated)
        return rows, imitated, chosen.metrics, {**state, **chosen.changed}

    def _sampling(
        self, specs: Mapping[str, NoiseSpec], extent: Extent, phase: Phase, kind: str
    ) -> SampleBlock:
        every = {**specs, **self._sampler.noise_spec()}
        purpose, deployment = phase.purpose + kind, phase.deployment

        def sample_block(block: int, count: int) -> Mapping[str, NDArray[np.generic]]:
            key = (phase.minibatch_key, deployment, block)
            minibatches = self._random(f"{purpose}-minibatches", *key)
            indices = self._sampler.sample_indices(minibatches, count, extent)
            noise = self._random(f"{purpose}-noise", deployment, block)
            return {**indices, **sample_noise(noise, every, count)}

        return sample_block


def fused_update(engine: Engine, algorithm: Algorithm, layout: RowLayout) -> Step:
    """The algorithm's update on packed rows, as the engine runs it: equal ones are compiled once,
    whatever samples for them.
    """
    return engine.fuse(
        lambda state, rows, imitated, sampled: algorithm.update(
            state, unpack(rows, layout), unpack(imitated, layout), sampled
        )
    )


def _fused_stacked_update(engine: Engine, algorithm: Algorithm, layout: RowLayout) -> Step:
    """The same of several states at once, and as many minibatches."""
    # Arguments have names, by which the engine knows what may differ between calls.
    return engine.fuse(
        lambda state, rows, imitated, sampled: each(
            lambda one, row, imitation, numbers: algorithm.update(
                one, unpack(row, layout), unpack(imitation, layout), numbers
            )
        )(state, rows, imitated, sampled)
    )


def check_finite(phase: Phase, done: int, metrics: Iterable[tuple[str, float]]) -> None:
    """Raises UserError if a metric, by its name, is not finite: training has diverged."""
    for name, value in metrics:
        if not math.isfinite(value):
            raise UserError(
                f"{phase.purpose} training diverged before update {done:,}: {name} is"
                f" {value}; lower the learning rates (algorithm.*), or look at the data and the"
                " rows drawn of them"
            )


def goes_back(algorithm: Algorithm, state: State) -> set[str]:
    """What of the state is an earlier policy's once that is gone on from; never the sampler's."""
    if isinstance(algorithm, Improving):
        return set(algorithm.policy_keys)
    return {name for name in state if not name.startswith("sampler_")}


def improvements(algorithm: Algorithm) -> int:
    """Improvement steps that `algorithm` makes after a phase's updates."""
    return algorithm.improvements if isinstance(algorithm, Improving) else 0
