"""All l1 distances between two sets of transitions, as d_e and d_c need them."""

import torch
from torch import Tensor

from otc_dist.otc.distances.interface import Ids


def gaps(queries: Tensor, references: Tensor, ids: Ids | None) -> Tensor:
    """All l1 distances (B, D); infinite of a transition to itself.

    Args:
        queries: (B, n).
        references: (D, n).
        ids: if a transition must not match itself.
    """
    total = (queries[:, :1] - references[:, 0]).abs()
    for column in range(1, queries.shape[1]):  # column by column: no (B, D, n) array
        total = total + (queries[:, column : column + 1] - references[:, column]).abs()
    if ids is not None:
        total = total.masked_fill(ids[0].unsqueeze(1) == ids[1], torch.inf)
    return total
