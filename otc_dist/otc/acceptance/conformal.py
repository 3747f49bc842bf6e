"""Acceptance by conformal p-values: what D_k itself could have looked like is kept.

A row's p-value is the share of D_k's held-out scores that are as large as its own. Where B_k
follows D_k's dynamics the p-values are uniform, and at level .01 nearly everything is accepted; so,
unlike the rank of Eq. 3, it does no harm where nothing has to be corrected.
"""

import torch
from torch import Tensor

from otc_dist.otc.acceptance.weighted import Weighted
from otc_dist.otc.distances.interface import Distance
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import Extent, Sampler


def create(distance: Distance, settings: CorrectionSection, batch_size: int) -> Sampler:
    """Rows by their p-value among the scores of D_k, which was held out from what judges it."""
    return Weighted(settings, batch_size, distance, weights, exclude_self=True)


def weights(settings: CorrectionSection, scores: Tensor, extent: Extent) -> Tensor:
    """min(1, p / level) (size,), with p = (1 + #{held out >= score}) / (1 + |D_k|)."""
    held_out = scores[extent.newest :].sort().values
    below = torch.searchsorted(held_out, scores)  # how many are smaller
    p = (1 + len(held_out) - below) / (1 + len(held_out))
    return (p / settings.level).clamp(max=1.0)
