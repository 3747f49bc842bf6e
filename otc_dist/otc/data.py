"""What a sampler looks at of an agent's own data."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import torch
from torch import Tensor


class Data(NamedTuple):
    """What a learner holds of its own: packed rows, what its distance keeps beside them, and what
    its sampler has prepared.
    """

    rows: Tensor  # (capacity, width)
    features: Tensor  # (capacity, n); n = 0 where no distance keeps anything
    # (capacity,) 0 or 1, half of the episodes each; empty where nothing is fitted by halves
    folds: Tensor = torch.zeros(0, dtype=torch.int64)
    # By name, the same in all updates after one deployment: alpha, or scores of all rows.
    prepared: Mapping[str, Tensor] = MappingProxyType({})
