"""OTC's mathematics as loops in numpy, in float64: what the fast one must equal."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def nearest_l1(queries: Float, references: Float) -> Float:
    """min over D of ||e - e*||_1, one pair at a time."""
    return np.array([min(np.abs(q - r).sum() for r in references) for q in queries])


def match_by_value(q: Float, online_q: Float) -> NDArray[np.int64]:
    """arg min over D of |Q - Q*|, densely."""
    return np.abs(q[:, None] - online_q[None, :]).argmin(1)


def value_distance(v: Float, matched: Float, normaliser: str) -> Float:
    """d_q(s', s'*) of the paper, and with the two other normalisers."""
    if normaliser == "paper":
        return np.abs(v / v.mean() - matched / matched.mean())
    if normaliser == "shared":
        return np.abs(v - matched) / abs(np.concatenate([v, matched]).mean())
    return np.abs((v - matched) / matched)


def priorities(distances: Float, alpha: float) -> Float:
    """Eq. 3: P(j) of each transition, rank 1 the nearest, ties in order."""
    order = sorted(range(len(distances)), key=lambda j: distances[j])
    weight = np.zeros(len(distances))
    for position, j in enumerate(order):
        weight[j] = (1.0 / (position + 1)) ** alpha
    return weight / weight.sum()


def prioritized(
    distances: Float, alpha: float, noise: Float, count: int, with_replacement: bool
) -> list[int]:
    """Sample by Eq. 3 from standard exponential noise.

    With replacement: the inverse of the cumulative distribution over ranks. Without: the
    transitions whose exponential clock of rate P(j) rings first, the clocks being in rank order
    (another form of the Gumbel top-k).
    """
    chances = priorities(distances, alpha)
    order = sorted(range(len(distances)), key=lambda j: distances[j])
    if with_replacement:
        cumulative = np.cumsum(chances[order])
        quantiles = 1 - np.exp(-noise[:count])
        return [order[int(np.argmax(cumulative >= u))] for u in quantiles]
    clocks = [noise[position] / chances[j] for position, j in enumerate(order)]
    return [order[p] for p in sorted(range(len(order)), key=lambda p: clocks[p])[:count]]
