"""d_f: how far s' is from what a forward model, corrected on D_k, expects after (s, a_i).

score = |s' - s - f_B(s, a_i) - c_k(s, a_i)|^2, where c_k is fitted to f_B's residuals on D_k: what
the others do now shows there, and nowhere else. c_k is fitted by halves of D_k's episodes, so that
no transition of D_k is judged by what was fitted to it.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from otc_dist.description import DynamicsSection
from otc_dist.otc.distances.change import matched_size
from otc_dist.otc.distances.interface import Scores, Setting
from otc_dist.otc.forward import FOLDS, Descent, Forward, Regression, apart
from otc_dist.otc.samplers.interface import MergedData
from otc_dist.steps.engine import Engine
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

LOOK_EVERY = 25  # updates of c_k between two looks at its held-out error
HELD_OUT = 5  # one in so many transitions of a half is held out to stop by


@dataclass(frozen=True)
class DynamicsDistance:
    """d_f of one agent, over the features of f_B that `Data.features` holds."""

    layout: RowLayout
    section: DynamicsSection

    @classmethod
    def create(cls, setting: Setting) -> "DynamicsDistance":
        return cls(setting.layout, setting.description.dynamics)

    @classmethod
    def features(cls, setting: Setting, engine: Engine) -> Forward:
        """(s, a_i) and the residual s' - s - f_B(s, a_i) of every transition."""
        return Forward(setting.description.dynamics, setting.layout, engine)

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        """No transition is judged by what was fitted to it, so `exclude_self` changes nothing."""
        extent = held.extent
        matched = matched_size(self.layout)
        inputs, residual = apart(held.data.features[: extent.size], matched)
        corrected = residual.clone()
        newest = torch.arange(extent.size, device=inputs.device) >= extent.newest
        folds = held.data.folds[: extent.size]
        # In the same half f_B's network is the same; of D_k's own rows the other half's c_k judges.
        judge = torch.where(newest, 1 - folds, folds)
        for fold in range(FOLDS):
            (mine,) = (newest & (folds == fold)).nonzero(as_tuple=True)
            network = self._correction(held, inputs[mine], residual[mine], fold)
            if network is not None:
                (judged,) = (judge == fold).nonzero(as_tuple=True)
                corrected[judged] -= self._regression.predict(network, inputs, judged)
        return Scores(corrected.square().sum(1))

    @property
    def _regression(self) -> Regression:
        section = self.section
        return Regression(
            matched_size(self.layout),
            self.layout.observation_size,
            section.correction_hidden,
            section.learning_rate,
        )

    def _correction(
        self, held: MergedData, inputs: Tensor, residual: Tensor, fold: int
    ) -> Tensor | None:
        """c_k's parameters where its held-out error was least; None if that of no correction is.

        Args:
            inputs: (n, matched) of one half of D_k, in the order of D_k.
            residual: (n, s) of f_B.
        """

        def random(*key: int | str) -> np.random.Generator:
            return held.random("correction", fold, *key)

        order = torch.from_numpy(random("held-out").permutation(len(inputs)))
        order = order.to(inputs.device)
        count = len(order) // HELD_OUT
        if count == 0:
            return None
        held_out, fitted = order[:count], order[count:]
        truth = residual[held_out]
        best, found = float(truth.double().square().mean()), None
        everything = torch.arange(count, device=inputs.device)

        def on_block(state: State, done: int, metrics: list[float]) -> None:
            nonlocal best, found
            expected = self._regression.predict(state["network"], inputs[held_out], everything)
            error = float((truth - expected).double().square().mean())
            if error < best:
                best, found = error, state["network"].clone()

        def examples(batch: Tensor) -> tuple[Tensor, Tensor]:
            chosen = fitted[batch]
            return inputs.index_select(0, chosen), residual.index_select(0, chosen)

        Descent(self._regression, held.engine, self.section.batch_size).run(
            examples,
            len(fitted),
            random,
            self.section.correction_updates,
            LOOK_EVERY,
            on_block,
        )
        return found
