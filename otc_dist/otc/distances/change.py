"""d_c, ours: transitions are matched by (s, a) and compared by s' - s.

The embedding of d_e is what a conditional VAE needs to rebuild a from (s, s'), which may be a
alone; d_c looks at the dynamics themselves. Each component is standardised over B_0.
"""

from dataclasses import dataclass
from itertools import chain

import torch
from torch import Tensor

from otc_dist.algorithms.interface import action_features, unpack
from otc_dist.otc.distances.gaps import gaps
from otc_dist.otc.distances.interface import Ids, Report, Setting
from otc_dist.otc.distances.nearest import FeatureDistance
from otc_dist.otc.samplers.correction import settings_of
from otc_dist.otc.samplers.interface import Random
from otc_dist.steps.engine import Engine
from otc_dist.steps.standardisation import mean_and_std
from otc_dist.steps.state import State
from otc_dist.transitions import RowLayout

CHUNK = 65_536  # rows looked at at once


@dataclass(frozen=True)
class ChangeDistance(FeatureDistance):
    """d_c of one agent, over `Changes`."""

    layout: RowLayout

    @classmethod
    def create(cls, setting: Setting) -> "ChangeDistance":
        return cls(settings_of(setting.description), setting.layout)

    @classmethod
    def features(cls, setting: Setting, engine: Engine) -> "Changes":
        """(s, a) and s' - s of every transition."""
        return Changes(setting.layout)

    def compare(self, queries: Tensor, references: Tensor, ids: Ids | None = None) -> Tensor:
        """d_c (B,) of features (B, n) by features (D, n)."""
        return matched_l1(queries, references, matched_size(self.layout), ids)


def matched_l1(queries: Tensor, references: Tensor, matched: int, ids: Ids | None = None) -> Tensor:
    """d_c: l1 distance (B,) of s' - s to that of the best match by (s, a) (Eq. 1).

    References in random order make ties fall at random.

    Args:
        queries: standardised [(s, a), s' - s] (B, n) of the minibatch B.
        references: the same (D, n) of D.
        matched: how many leading components are (s, a).
        ids: if a transition must not match itself.
    """
    matches = gaps(queries[:, :matched], references[:, :matched], ids).argmin(1)
    return (queries[:, matched:] - references[:, matched:][matches]).abs().sum(1)


class Changes:
    """Features [(s, a), s' - s] of packed rows, each component standardised: see `Features`.

    Attributes:
        matched: how many leading features are (s, a), by which transitions are matched.
    """

    name = "change"
    updates = 0  # nothing is learned

    def __init__(self, layout: RowLayout) -> None:
        self._layout = layout
        self.matched = matched_size(layout)
        self.size = self.matched + layout.observation_size
        self.state: State | None = None

    def fit(self, rows: Tensor, folds: Tensor, random: Random, report: Report) -> None:
        """Take mean and standard deviation from packed rows (N, width) of B_0."""
        batch = unpack(rows, self._layout)
        action = action_features(batch.action, self._layout.choices)
        mean, std = mean_and_std(
            chain(
                batch.observation.T,
                action.T,
                # One at a time: all together are as large as the data.
                (b - a for a, b in zip(batch.observation.T, batch.next_observation.T, strict=True)),
            )
        )
        self.state = {"mean": mean, "std": std}

    def embed(self, rows: Tensor, folds: Tensor, out: Tensor) -> None:
        """Write the features of packed rows (N, width) to `out` (N, size); nothing before `fit`."""
        if self.state is None:
            return
        for part, written in zip(torch.split(rows, CHUNK), torch.split(out, CHUNK), strict=True):
            written[:] = self.of(part)

    def of(self, rows: Tensor) -> Tensor:
        """The features (n, size) of packed rows (n, width), after `fit`."""
        if self.state is None:
            raise ValueError("features are asked for before the fit")
        batch = unpack(rows, self._layout)
        action = action_features(batch.action, self._layout.choices)
        change = batch.next_observation - batch.observation
        features = torch.cat((batch.observation, action, change), dim=1)
        return (features - self.state["mean"]) / self.state["std"]


def matched_size(layout: RowLayout) -> int:
    """The number of features that stand for (s, a)."""
    return layout.observation_size + (layout.choices or layout.action_size)
