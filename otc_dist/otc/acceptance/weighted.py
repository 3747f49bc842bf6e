"""Acceptance once a deployment: every transition of B_k has a weight, and is drawn by it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from otc_dist.otc.data import Data
from otc_dist.otc.distances.interface import Distance, scored
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import (
    Extent,
    Gathered,
    Indices,
    MergedData,
    Preparation,
    Sampler,
    Selection,
)
from otc_dist.steps.noise import Noise
from otc_dist.steps.state import State

# From scores (size,), D_k's last, and the extent: how likely each row is accepted (size,), 0 to 1.
Weigh = Callable[[CorrectionSection, Tensor, Extent], Tensor]


@dataclass(frozen=True)
class Weighted(Sampler):
    """Draws rows of B_k in proportion to weights that follow from their scores.

    D_k itself is always accepted whole: it is what the others are held against.

    Attributes:
        exclude_self: whether D_k is scored as if it were not there.
    """

    settings: CorrectionSection
    batch_size: int
    distance: Distance
    weigh: Weigh
    exclude_self: bool = False

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        return {"quantile": random.random((updates, self.batch_size))}

    def begin(self, held: MergedData) -> Preparation:
        """Prepares the sums of the weights up to each row (size,), in float64; where all weights
        are 0 or 1, the rows that have one instead: a sum is then a place among them.
        """
        extent = held.extent
        exclude = self.exclude_self or self.settings.exclude_self
        found = scored(self.distance, held, exclude_self=exclude)
        weights = self.weigh(self.settings, found.values, extent).double()
        weights[extent.newest :] = 1.0
        sums = weights.cumsum(0)
        prepared = {"total": sums[-1]}
        if bool(((weights == 0) | (weights == 1)).all()):
            prepared["accepted"] = weights.nonzero().squeeze(1)
        else:
            prepared["sums"] = sums
        measured = {"accepted": float(sums[-1]) / extent.size, "guarded": found.guarded}
        return Preparation(held.data._replace(prepared=prepared), measured=measured)

    def gather(self, state: State, data: Data, sampled: Noise) -> Gathered:
        # Beyond [0, total) a row without weight could be met.
        below = sampled["quantile"] * data.prepared["total"]
        if "accepted" in data.prepared:  # a search finds the same, in 20 steps through memory
            return {"rows": data.prepared["accepted"].index_select(0, below.long())}
        return {"rows": torch.searchsorted(data.prepared["sums"], below, right=True)}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        rows = gathered["rows"]
        return Selection(rows, rows)
