"""What d_c looks at: (s, a) and the change s' - s of a transition, standardised over B_0."""

import torch
from torch import Tensor

from otc_dist.algorithms.interface import action_features, unpack
from otc_dist.algorithms.moments import moments
from otc_dist.transitions import RowLayout

CHUNK = 65_536  # rows looked at at once


class Changes:
    """Features [(s, a), s' - s] of packed rows, each component standardised; nothing is learned.

    Attributes:
        matched: how many leading features are (s, a), by which transitions are matched.
        size: of the features.
    """

    def __init__(self, layout: RowLayout) -> None:
        self._layout = layout
        self.matched = matched_size(layout)
        self.size = self.matched + layout.observation_size
        self._mean: Tensor | None = None
        self._std: Tensor | None = None

    def fit(self, rows: Tensor) -> None:
        """Take mean and standard deviation from packed rows (N, width) of B_0."""
        self._mean, self._std = moments(self._features(rows).T)

    def embed(self, rows: Tensor, out: Tensor) -> None:
        """Write the features of packed rows (N, width) to `out` (N, size); not before `fit`."""
        if self._mean is not None and self._std is not None:
            for part, written in zip(
                torch.split(rows, CHUNK), torch.split(out, CHUNK), strict=True
            ):
                written[:] = (self._features(part) - self._mean) / self._std

    def _features(self, rows: Tensor) -> Tensor:
        batch = unpack(rows, self._layout)
        action = action_features(batch.action, self._layout.choices)
        change = batch.next_observation - batch.observation
        return torch.cat((batch.observation, action, change), dim=1)


def matched_size(layout: RowLayout) -> int:
    """The number of features that stand for (s, a)."""
    return layout.observation_size + (layout.choices or layout.action_size)
