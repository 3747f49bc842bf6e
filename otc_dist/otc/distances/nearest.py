"""What d_e and d_c share: all distances to D_k, in parts, and their mean over a sample of B_k."""

from collections.abc import Callable

import torch
from torch import Tensor

from otc_dist.otc.correction import CorrectionSection
from otc_dist.otc.distances.interface import Ids
from otc_dist.otc.samplers import Held

PAIR_CHUNK = 256  # transitions compared with all of D_k at once

Compare = Callable[[Tensor, Tensor, Ids | None], Tensor]  # (B, n), (D, n) -> (B,)


def distances_to_newest(
    held: Held, compare: Compare, numbers: Tensor, *, exclude_self: bool
) -> Tensor:
    """Distances (n,) of the rows `numbers` (n,) to all of D_k, by their features.

    Args:
        compare: the distance of each of B queries to D references.
    """
    features, extent = held.data.features, held.extent
    online = torch.arange(extent.newest, extent.size, device=features.device)
    references, fused = features[online], held.engine.fuse(compare)
    found = []
    for part in torch.split(numbers, PAIR_CHUNK):
        # The last part is filled up: code is compiled for one shape.
        whole = torch.cat((part, part[:1].expand(PAIR_CHUNK - len(part))))
        ids = (whole, online) if exclude_self else None
        found.append(fused(features[whole], references, ids)[: len(part)])
    return torch.cat(found)


def sampled_similarity(
    held: Held, compare: Compare, settings: CorrectionSection
) -> tuple[float, float]:
    """𝔻_k: the mean distance over a sample of B_k, matched against all of D_k.

    The sample has the same size at every k, so that 𝔻_k / 𝔻_{k-1} compares like with like.
    """
    extent, random = held.extent, held.random("similarity")
    count = min(settings.similarity_sample, extent.offline)
    chosen = torch.from_numpy(random.choice(extent.size, count, replace=False))
    chosen = chosen.to(held.data.features.device)
    found = distances_to_newest(held, compare, chosen, exclude_self=settings.exclude_self)
    return float(found.double().sum()) / count, 0.0
