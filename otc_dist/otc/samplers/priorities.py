"""Proportional prioritized sampling over many rows: P(j) = p_j / sum_i p_i (Schaul et al., 2016).

Priorities lie in blocks of BLOCK rows, beside the blocks' sums: row j at (j // BLOCK, j % BLOCK).
A draw searches the running sum of the sums, then one block; a change adds up the blocks that it
touches. So neither looks at all rows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor


BLOCK = 128  # rows: with 400,000 a draw of 128 reads 3,125 sums and 16,384 priorities

# Priorities are multiples of this. Their float64 sums (below 2^33) are then exact in any order of
# addition, so a draw depends neither on the engine nor on the history of the sums.
RESOLUTION = 2.0**-20


def empty(capacity: int, device: torch.device) -> Tensor:
    """Priorities (blocks, BLOCK) float32 of 0, which is never drawn. The last block may be longer
    than the rows left.
    """
    return torch.zeros(-(-capacity // BLOCK), BLOCK, device=device)


def of(values: Tensor) -> tuple[Tensor, Tensor]:
    """Priorities and sums of rows with the priorities `values` (n,)."""
    priorities = empty(len(values), values.device)
    priorities.view(-1)[: len(values)] = _rounded(values)
    return priorities, priorities.double().sum(1)


def fill(priorities: Tensor, start: int, stop: int, value: Tensor | float) -> tuple[Tensor, Tensor]:
    """Priorities with those of rows [start, stop) set to `value`, and the sums (blocks,) float64
    of all blocks.
    """
    filled = priorities.clone()
    filled.view(-1)[start:stop] = _rounded(torch.as_tensor(value))
    return filled, filled.double().sum(1)


def replace(
    priorities: Tensor, sums: Tensor, rows: Tensor, values: Tensor
) -> tuple[Tensor, Tensor]:
    """Priorities and sums with `rows` (n,), in ascending order, set to `values` (n,)."""
    # A row given twice gets its first value: which of two writes wins is not defined on a GPU.
    values = _rounded(values)[torch.searchsorted(rows, rows)]
    priorities = priorities.view(-1).index_put((rows,), values).view_as(priorities)
    blocks = rows // BLOCK
    return priorities, sums.index_put((blocks,), priorities[blocks].double().sum(1))


def choose(priorities: Tensor, sums: Tensor, noise: Tensor) -> Tensor:
    """Row numbers (n,) in ascending order, with replacement: one from each of n equal parts of
    the total priority, as in proportional prioritized replay.

    Args:
        priorities: (blocks, BLOCK), not all 0.
        sums: (blocks,) their sums.
        noise: (n,) uniform float32 numbers of [0, 1): where in its part each row falls.
    """
    running = sums.cumsum(0)
    parts = torch.arange(len(noise), device=noise.device)
    points = (parts + noise.double()) / len(noise) * running[-1]
    blocks = torch.searchsorted(running, points, right=True)
    rest = points - (running - sums)[blocks]
    within = priorities[blocks].double().cumsum(1)
    return blocks * BLOCK + (within <= rest.unsqueeze(1)).sum(1)


def _rounded(values: Tensor) -> Tensor:
    return (values / RESOLUTION).round() * RESOLUTION
