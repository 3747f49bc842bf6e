"""What d_e and d_c share: all distances to D_k, in parts, and their mean over a sample of B_k."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from otc_dist.otc.data import Data
from otc_dist.otc.distances.interface import Ids, Scores
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import MergedData
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State

PAIR_CHUNK = 256  # transitions compared with all of D_k at once

Compare = Callable[[Tensor, Tensor, Ids | None], Tensor]  # (B, n), (D, n) -> (B,)


@dataclass(frozen=True)
class FeatureDistance(ABC):
    """A distance between what `Data.features` holds of two transitions, and of nothing else."""

    settings: CorrectionSection

    @abstractmethod
    def compare(self, queries: Tensor, references: Tensor, ids: Ids | None = None) -> Tensor:
        """The distance (B,) of each of the features (B, n) to the features (D, n)."""

    def noise_spec(self, candidates: int) -> dict[str, NoiseSpec]:
        return {}

    def gather(self, data: Data, numbers: Tensor) -> Tensor:
        return data.features.index_select(0, numbers)

    def between(
        self, state: State, candidates: Tensor, references: Tensor, ids: Ids | None, noise: Noise
    ) -> tuple[Tensor, Tensor]:
        far = self.compare(candidates, references, ids)
        return far, far.new_zeros(())

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        numbers = torch.arange(held.extent.size, device=held.data.rows.device)
        return Scores(distances_to_newest(held, self.compare, numbers, exclude_self=exclude_self))

    def similarity(self, held: MergedData) -> tuple[float, float]:
        """𝔻_k over a sample of B_k."""
        return sampled_similarity(held, self.compare, self.settings)


def distances_to_newest(
    held: MergedData, compare: Compare, numbers: Tensor, *, exclude_self: bool
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
    held: MergedData, compare: Compare, settings: CorrectionSection
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
