"""A forward model of B_0, and regressions as pure functions: what d_f and `typical` stand on.

f_B(s, a_i) -> s' - s is fitted once, by halves: the episodes of B_0 are two folds, each has a
network, and a transition is always judged by the network that has not seen its episode.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import mse_loss

from otc_dist.description import DynamicsSection
from otc_dist.otc.distances.change import Changes
from otc_dist.otc.distances.interface import Report
from otc_dist.otc.samplers.interface import Random
from otc_dist.steps.engine import Engine
from otc_dist.steps.networks import Mlp, descend, fresh_state
from otc_dist.steps.noise import Noise, to_tensors
from otc_dist.steps.state import State
from otc_dist.steps.training import BLOCK, OnBlock, train
from otc_dist.transitions import RowLayout

FOLDS = 2
CHUNK = 8192  # rows judged at once

# Of row numbers (B,): the inputs (B, inputs) and the targets (B, outputs) of a regression.
Examples = Callable[[Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True)
class Regression:
    """A network from standardised (s, a_i) to a change of the state, by least squares."""

    inputs: int
    outputs: int
    hidden: tuple[int, ...]
    learning_rate: float

    @cached_property
    def network(self) -> Mlp:
        return Mlp((self.inputs,), self.hidden, self.outputs)

    def initial_state(self, random: np.random.Generator) -> dict[str, np.ndarray]:
        """A fresh network, its moments, and the count of updates."""
        return fresh_state({"network": self.network.initialise(random)})

    def update(self, state: State, inputs: Tensor, targets: Tensor) -> tuple[State, Tensor]:
        """One Adam step on the mean squared error of a batch (B, inputs), (B, outputs)."""
        counted = dict(state, updates=state["updates"] + 1)
        new, loss = descend(
            counted,
            "network",
            self.learning_rate,
            lambda network: mse_loss(self.network.apply(network, inputs), targets),
        )
        return new, loss.view(1)

    def predict(self, network: Tensor, inputs: Tensor, chosen: Tensor) -> Tensor:
        """(n, outputs) of the rows `chosen` (n,) of inputs (N, inputs), part by part."""
        found = inputs.new_empty(len(chosen), self.outputs)
        with torch.no_grad():
            for part, out in zip(
                torch.split(chosen, CHUNK), torch.split(found, CHUNK), strict=True
            ):
                out[:] = self.network.apply(network, inputs[part])
        return found


@dataclass(frozen=True)
class Descent:
    """A regression trained on minibatches of examples."""

    regression: Regression
    engine: Engine
    batch_size: int

    def run(
        self,
        examples: Examples,
        count: int,
        random: Random,
        updates: int,
        block: int,
        on_block: OnBlock,
    ) -> None:
        """From a fresh network.

        Args:
            count: of examples, N; they are numbered from 0.
            block: updates between two calls of `on_block`.
        """
        step, device = self.engine.fuse(self.regression.update), self.engine.device

        def update(state: State, sampled: Noise) -> tuple[State, Tensor]:
            return step(state, *examples(sampled["batch"]))

        def sample_block(number: int, length: int) -> Mapping[str, NDArray[np.generic]]:
            shape = (length, self.batch_size)
            return {"batch": random("minibatches", number).integers(0, count, shape)}

        state = to_tensors(self.regression.initial_state(random("initial")), device)
        record, span = self.engine.record(update), (0, updates)
        train(state, record, sample_block, device, span, block, on_block)


class Forward:
    """Standardised (s, a_i), then the residual s' - s - f_B(s, a_i): see `Features`."""

    name = "dynamics"

    def __init__(self, section: DynamicsSection, layout: RowLayout, engine: Engine) -> None:
        self._section, self._engine = section, engine
        self._changes = Changes(layout)
        self.updates = FOLDS * section.updates
        self._regression = Regression(
            self._changes.matched, layout.observation_size, section.hidden, section.learning_rate
        )
        self._state: State | None = None

    @property
    def size(self) -> int:
        """Numbers kept of a transition."""
        return self._changes.size

    @property
    def state(self) -> State | None:
        """`network_0` and `network_1` (n,), each fitted without the episodes of that fold; `mean`
        and `std`, by which transitions are standardised.
        """
        return self._state

    @state.setter
    def state(self, state: State | None) -> None:
        self._state = state
        if state is not None:
            self._changes.state = {name: state[name] for name in ("mean", "std")}

    def fit(self, rows: Tensor, folds: Tensor, random: Random, report: Report) -> None:
        """Fit both networks to B_0 and freeze."""
        self._changes.fit(rows, folds, random, report)
        fitted, updates = dict(self._changes.state or {}), self._section.updates
        for fold in range(FOLDS):
            (others,) = (folds != fold).nonzero(as_tuple=True)

            def on_block(state: State, done: int, metrics: list[float], fold: int = fold) -> None:
                fitted[f"network_{fold}"] = state["network"]
                report(fold * updates + done, {"dynamics_loss": metrics[0]})

            def examples(batch: Tensor, others: Tensor = others) -> tuple[Tensor, Tensor]:
                features = self._changes.of(rows.index_select(0, others[batch]))
                return apart(features, self._changes.matched)

            descent = Descent(self._regression, self._engine, self._section.batch_size)
            own = partial(random, fold)
            descent.run(examples, len(others), own, updates, BLOCK, on_block)
        self.state = fitted

    def embed(self, rows: Tensor, folds: Tensor, out: Tensor) -> None:
        """Write the features of packed rows (N, width) to `out` (N, size); nothing before `fit`."""
        for part, inputs, residual in self.residuals(rows, folds):
            out[part] = torch.cat((inputs, residual), dim=1)

    def residuals(self, rows: Tensor, folds: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """All of packed rows (N, width), part by part, so that few are held at once: their numbers
        (n,), (s, a_i) (n, matched) and residuals (n, s). Nothing before `fit`.
        """
        if self._state is None:
            return
        for fold in range(FOLDS):
            network = self._state[f"network_{fold}"]
            (mine,) = (folds == fold).nonzero(as_tuple=True)
            for part in torch.split(mine, CHUNK):
                inputs, change = apart(self._changes.of(rows[part]), self._changes.matched)
                with torch.no_grad():
                    residual = change - self._regression.network.apply(network, inputs)
                yield part, inputs, residual


def apart(features: Tensor, matched: int) -> tuple[Tensor, Tensor]:
    """Views of `Forward`'s features (N, size): (s, a_i) (N, matched), and the rest (N, s)."""
    return features[:, :matched], features[:, matched:]
