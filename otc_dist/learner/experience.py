"""B_k of one agent: where a learner keeps its own transitions, and what is compared of them."""

import numpy as np
import torch
from torch import Tensor

from otc_dist.learner.action_scale import ActionScale
from otc_dist.learner.folds import folds
from otc_dist.otc.data import Data
from otc_dist.otc.distances.interface import Features
from otc_dist.otc.samplers.interface import Extent
from otc_dist.transitions import RowLayout, Transitions


class Experience:
    """B_0, and D_1 .. D_k after it, as packed rows with actions scaled to [-1, 1].

    Memory is taken once. On the CPU numpy and torch share it; a GPU has a copy of its own.

    Args:
        offline: B_0.
        to_come: the most transitions that deployments will add.
        features: what to keep of each transition beside it; None: nothing.
        folded: whether to halve the data by episodes, which fits need.

    Attributes:
        data: the rows, their features and folds, on the device that trains.

    Raises:
        ValueError: see `RowLayout.pack`; more transitions than were to come.
    """

    def __init__(
        self,
        layout: RowLayout,
        scale: ActionScale,
        offline: Transitions,
        to_come: int,
        features: Features | None,
        device: torch.device,
        *,
        folded: bool = False,
    ) -> None:
        self._layout, self._scale, self._features = layout, scale, features
        self._rows = np.empty((len(offline) + to_come, layout.width), dtype=np.float32)
        self._rows[len(offline) :] = np.nan  # whoever learns from a row that is not there yet fails
        self._size = self._newest_start = 0  # where B_k ends, and D_k begins
        self._offline_size = len(offline)
        rows = torch.from_numpy(self._rows).to(device)
        width = features.size if features else 0
        self.data = Data(
            rows,
            torch.zeros(len(rows), width, device=device),
            torch.zeros(len(rows) if folded else 0, dtype=torch.int64, device=device),
        )
        self._append(offline)

    @property
    def extent(self) -> Extent:
        """Where B_0 ends, D_k begins and B_k ends."""
        return Extent(self._offline_size, self._newest_start, self._size)

    @property
    def capacity(self) -> int:
        """Transitions that B_0 and all deployments may have."""
        return len(self._rows)

    @property
    def offline(self) -> Tensor:
        """The rows of B_0, (N, width)."""
        return self.data.rows[: self._offline_size]

    @property
    def folds(self) -> Tensor:
        """Which half each row (capacity,) is in; empty unless `folded`."""
        return self.data.folds

    def merge(self, data: Transitions) -> None:
        """Append D_k (line 5 of Algorithm 1), without steps that did not happen."""
        self._append(data.sound())

    def embed(self) -> None:
        """Compute the features of all transitions anew: they were fit, or loaded, just now."""
        self._embed(0, self._size)

    def _append(self, data: Transitions) -> None:
        start, end = self._size, self._size + len(data)
        if end > len(self._rows):
            raise ValueError(f"{end} transitions do not fit into {len(self._rows)} rows")
        rows = self._layout.pack(data, self._rows[start:end])
        actions = rows[:, self._layout.action]
        actions[:] = self._scale.scaled(actions)
        self._newest_start, self._size = start, end
        if self.data.rows.device.type != "cpu":
            self.data.rows[start:end] = torch.from_numpy(rows)
        if len(self.data.folds):
            self.data.folds[start:end] = torch.from_numpy(folds(data))
        self._embed(start, end)

    def _embed(self, start: int, end: int) -> None:
        if self._features:
            part = slice(start, end)
            data = self.data
            self._features.embed(data.rows[part], data.folds[part], data.features[part])
