"""Uniform sampling of the deployments' data alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from otc_dist.description.sampling import Arm, SamplingSection
from otc_dist.otc.samplers.interface import Extent, Gathered, Indices, Sampler, Selection
from otc_dist.steps.noise import Noise
from otc_dist.steps.state import State

if TYPE_CHECKING:
    import numpy as np

    from otc_dist.otc.distances.interface import Setting


class OnlineOnlySection(SamplingSection):
    """Uniform sampling of D_1 .. D_k."""

    arms: ClassVar[Mapping[str, Arm]] = {
        "online-only": Arm(("sampling.name=online-only",), "the deployments' data alone"),
    }

    name: Literal["online-only"] = "online-only"


@dataclass(frozen=True)
class OnlineOnly(Sampler):
    """Uniform over D_1 .. D_k."""

    Section: ClassVar[type[SamplingSection]] = OnlineOnlySection

    batch_size: int

    @classmethod
    def create(cls, settings: OnlineOnlySection, setting: Setting, capacity: int) -> Sampler:
        return cls(setting.description.algorithm.batch_size)

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        shape = (updates, self.batch_size)
        return {"batch": random.integers(extent.offline, extent.size, shape)}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        return Selection(sampled["batch"], sampled["batch"])
