"""`typical`: how far s' is from what a forward model of B_0 expects after (s, a_i).

The others' actions are no input of it, so where they acted unusually for the data, s' is far from
its mean. It needs no online data: what it selects is the usual, not the present. docs/method.md
says why that helps.
"""

from dataclasses import dataclass

from torch import Tensor

from otc_dist.otc.distances.interface import Scores, Setting
from otc_dist.otc.forward import Forward
from otc_dist.otc.samplers.interface import MergedData
from otc_dist.steps.engine import Engine


@dataclass(frozen=True)
class TypicalDistance:
    """|s' - s - f_B(s, a_i)|^2 of one agent, which `Data.features` holds."""

    @classmethod
    def create(cls, setting: Setting) -> "TypicalDistance":
        return cls()

    @classmethod
    def features(cls, setting: Setting, engine: Engine) -> "Misses":
        """The square of what f_B misses s' by, of every transition."""
        return Misses(setting.description.dynamics, setting.layout, engine)

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        """No transition was fitted to itself, so `exclude_self` changes nothing."""
        return Scores(held.data.features[: held.extent.size, 0])


class Misses(Forward):
    """|s' - s - f_B(s, a_i)|^2 alone: one number a transition, as f_B never changes."""

    @property
    def size(self) -> int:
        """Numbers kept of a transition."""
        return 1

    def embed(self, rows: Tensor, folds: Tensor, out: Tensor) -> None:
        """Write the features of packed rows (N, width) to `out` (N, 1); nothing before `fit`."""
        for part, _, residual in self.residuals(rows, folds):
            out[part, 0] = residual.square().sum(1)
