"""Mean and spread of a data set's columns, by which networks see standardised inputs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor


OFFSET = 1e-3  # TD3+BC's: an entry that is constant in B_0 may change later


def mean_and_std(columns: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation, plus OFFSET, of each column: float32 (n,) both.

    Args:
        columns: n of them, (N,) each, one at a time in float64: a data set is never copied whole.
    """
    found = [torch.std_mean(column.double(), correction=0) for column in columns]
    std, mean = (torch.stack(part).float() for part in zip(*found, strict=True))
    return mean, std + OFFSET
