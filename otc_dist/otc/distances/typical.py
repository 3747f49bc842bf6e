"""`typical`: how far s' is from what a forward model of B_0 expects after (s, a_i).

The others' actions are no input of it, so where they acted unusually for the data, s' is far from
its mean. It needs no online data: what it selects is the usual, not the present. docs/method.md
tells why that helps.
"""

from dataclasses import dataclass

from otc_dist.engine import Engine
from otc_dist.otc.distances.change import matched_size
from otc_dist.otc.distances.interface import Scores, Setting
from otc_dist.otc.forward import Forward, apart
from otc_dist.otc.samplers import Held
from otc_dist.transitions import RowLayout


@dataclass(frozen=True)
class TypicalDistance:
    """|s' - s - f_B(s, a_i)|^2 of one agent, over f_B's features in `Data.features`."""

    layout: RowLayout

    @classmethod
    def create(cls, setting: Setting) -> "TypicalDistance":
        return cls(setting.layout)

    @classmethod
    def features(cls, setting: Setting, engine: Engine) -> Forward:
        """(s, a_i) and the residual s' - s - f_B(s, a_i) of every transition."""
        return Forward(setting.description.dynamics, setting.layout, engine)

    def scores(self, held: Held, *, exclude_self: bool) -> Scores:
        """No transition was fitted to itself, so `exclude_self` changes nothing."""
        features = held.data.features[: held.extent.size]
        return Scores(apart(features, matched_size(self.layout))[1].square().sum(1))
