"""The f-function of OTC: rank-based prioritization of a minibatch (Eq. 3)."""

import torch
from torch import Tensor


def prioritize(
    distances: Tensor, alpha: Tensor, noise: Tensor, count: int, *, with_replacement: bool
) -> Tensor:
    """Positions (count,) sampled from a minibatch with P(j) proportional to (1 / rank(j))^alpha.

    Rank 1 is the smallest distance. The sort is stable and minibatches come in random order, so
    equal distances are ranked at random.

    Args:
        distances: d(s', s'*) (B,).
        alpha: scalar, degree of the correction; 0 is uniform.
        noise: (B,) standard exponential draws. Without replacement: Gumbel top-k on
            -alpha log rank. With replacement: its first `count` values, as
            quantiles 1 - exp(-noise).
        count: transitions to sample.
    """
    ranks = torch.arange(1, len(distances) + 1, device=distances.device, dtype=distances.dtype)
    log_priority = -alpha * ranks.log()
    if with_replacement:
        cumulative = log_priority.softmax(0).cumsum(0)
        quantile = -torch.expm1(-noise[:count]) * cumulative[-1]
        chosen = torch.searchsorted(cumulative, quantile).clamp(max=len(distances) - 1)
    else:
        chosen = (log_priority - noise.log()).topk(count).indices
    return distances.argsort(stable=True)[chosen]
