"""Acceptance of a fixed share: the best `sampling.share` of B_k, and the rest not at all."""

import math

import torch
from torch import Tensor

from otc_dist.otc.acceptance.weighted import Weighted
from otc_dist.otc.distances.interface import Distance
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import Extent, Sampler


def create(distance: Distance, settings: CorrectionSection, batch_size: int) -> Sampler:
    """The best `sampling.share` of B_k by the distance, each row as likely as another."""
    return Weighted(settings, batch_size, distance, weights)


def weights(settings: CorrectionSection, scores: Tensor, extent: Extent) -> Tensor:
    """1 for the ceil(share * size) rows with the smallest scores (size,), else 0. Of equals the
    earlier row counts as the better.
    """
    count = math.ceil(settings.share * extent.size)
    found = torch.zeros_like(scores)
    found[scores.argsort(stable=True)[:count]] = 1.0
    return found
