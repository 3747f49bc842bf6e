"""The d-functions of OTC: distances between transitions in embedding, in value and in change.

All answer one question for every transition of a minibatch B: how far is its next state from
the next state of its best match in D (Eq. 1)?
"""

import torch
from torch import Tensor

from otc_dist.description import NormaliserName

GUARD = 1e-2  # a normaliser below this many standard deviations is replaced
NEIGHBOURS = 2  # looked at on each side of the insertion point: one may be the query itself

Ids = tuple[Tensor, Tensor]  # row numbers (B,) of the queries and (D,) of the references


def nearest_l1(queries: Tensor, references: Tensor, ids: Ids | None = None) -> Tensor:
    """d_e: l1 distance (B,) of each query (B, e) to the nearest reference (D, e).

    The one embedding mu(s, a, s') stands for both e(s, a) and e(s'), as in the paper's
    implementation, so the matching distance is the next-state distance and no index is needed.

    Args:
        queries: mu (B, e).
        references: mu (D, e).
        ids: if a transition must not match itself.
    """
    return _gaps(queries, references, ids).amin(1)


def matched_l1(queries: Tensor, references: Tensor, matched: int, ids: Ids | None = None) -> Tensor:
    """d_c: l1 distance (B,) of s' - s to that of the best match by (s, a) (Eq. 1).

    References in random order make ties fall at random.

    Args:
        queries: standardised [(s, a), s' - s] (B, n) of the minibatch B.
        references: the same (D, n) of D.
        matched: how many leading components are (s, a).
        ids: if a transition must not match itself.
    """
    matches = _gaps(queries[:, :matched], references[:, :matched], ids).argmin(1)
    return (queries[:, matched:] - references[:, matched:][matches]).abs().sum(1)


def _gaps(queries: Tensor, references: Tensor, ids: Ids | None) -> Tensor:
    """All l1 distances (B, D); infinite of a transition to itself."""
    total = (queries[:, :1] - references[:, 0]).abs()
    for column in range(1, queries.shape[1]):  # column by column: no (B, D, e) array
        total = total + (queries[:, column : column + 1] - references[:, column]).abs()
    if ids is not None:
        total = total.masked_fill(ids[0].unsqueeze(1) == ids[1], torch.inf)
    return total


def match_values(queries: Tensor, references: Tensor, ids: Ids | None = None) -> Tensor:
    """Index (B,) of the reference whose Q is nearest to each query's: arg min d_q (Eq. 1).

    References in random order make ties fall at random: of equally near neighbours the one that
    comes first in that order is taken.

    Args:
        queries: Q(s, a_i) (B,) of the minibatch B.
        references: Q(s, a_i) (D,) of D.
        ids: if a transition must not match itself.
    """
    values, order = references.sort(stable=True)
    insertion = torch.searchsorted(values, queries).unsqueeze(1)
    nearby = insertion + torch.arange(-NEIGHBOURS, NEIGHBOURS, device=queries.device)
    inside = (nearby >= 0) & (nearby < len(values))
    nearby = nearby.clamp(0, len(values) - 1)
    gap = (values[nearby] - queries.unsqueeze(1)).abs()
    candidates = order[nearby]
    if ids is not None:
        inside = inside & (ids[1][candidates] != ids[0].unsqueeze(1))
    gap = gap.masked_fill(~inside, torch.inf)
    tied = gap == gap.amin(1, keepdim=True)
    return candidates.masked_fill(~tied, len(values)).amin(1)


def next_state_distance(
    values: Tensor, matched: Tensor, normaliser: NormaliserName
) -> tuple[Tensor, Tensor]:
    """d_q(s', s'*) (B,) between V(s') and V(s'*) of the best matches.

    `paper`:    |V / E V - V* / E V*|, means over the transitions and over their matches
                (the paper's formula). Where the two means differ, even a perfect match is at a
                distance, which then grows with V: see the documentation.
    `shared`:   |V - V*| / |E|, one mean over both.
    `relative`: |V - V*| / |V*|.

    A normaliser near zero (less than GUARD standard deviations) is replaced by that bound.

    Returns:
        The distances, and how many normalisers were replaced (a float scalar).
    """
    if normaliser == "paper":
        mean, guarded = _guard(values.mean(), values.std())
        matched_mean, matched_guarded = _guard(matched.mean(), matched.std())
        return (values / mean - matched / matched_mean).abs(), guarded + matched_guarded
    both = torch.cat((values, matched))
    scale = both.mean() if normaliser == "shared" else matched
    scale, guarded = _guard(scale, both.std())
    return ((values - matched) / scale).abs(), guarded


def _guard(scale: Tensor, spread: Tensor) -> tuple[Tensor, Tensor]:
    bound = GUARD * spread + torch.finfo(scale.dtype).tiny
    small = scale.abs() < bound
    return torch.where(small, torch.where(scale < 0, -bound, bound), scale), small.sum().to(
        scale.dtype
    )
