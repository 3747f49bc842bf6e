"""Uniform sampling of the merged data, the reference of all comparisons; with as much online data
beside it, RLPD's symmetric sampling (Ball et al., ICML 2023).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from otc_dist.description.sampling import Arm, SamplingSection
from otc_dist.otc.samplers.interface import Extent, Gathered, Indices, Sampler, Selection
from otc_dist.otc.samplers.mixing import with_online
from otc_dist.steps.noise import Noise
from otc_dist.steps.state import State

if TYPE_CHECKING:
    import numpy as np

    from otc_dist.otc.distances.interface import Setting


_ALL_ALIKE = ("sampling.name=uniform", "sampling.online_share=0")


class UniformSection(SamplingSection):
    """Uniform sampling of B_k."""

    arms: ClassVar[Mapping[str, Arm]] = {
        "typical-offline": Arm(
            ("offline.rows=typical", *_ALL_ALIKE),
            "uniform, from a pi_0 of its own, trained on the typical tenth of B_0",
        ),
        "uniform": Arm(_ALL_ALIKE, "all of B_k alike: the reference"),
        "rlpd": Arm(
            ("sampling.name=uniform", "sampling.online_share=0.5"),
            "half of every batch online data, the rest from B_k (RLPD)",
        ),
    }

    name: Literal["uniform"] = "uniform"
    online_share: float = Field(
        default=0.0, ge=0, lt=1, description="of every batch that is D_1 .. D_k's (RLPD: 0.5)"
    )

    @property
    def title(self) -> str:
        online = f", {self.online_share:.0%} of every batch online data"
        return super().title + (online if self.online_share else "")


@dataclass(frozen=True)
class Uniform(Sampler):
    """Uniform over the merged data B_k."""

    Section: ClassVar[type[SamplingSection]] = UniformSection

    batch_size: int

    @classmethod
    def create(cls, settings: UniformSection, setting: Setting, capacity: int) -> Sampler:
        batch = setting.description.algorithm.batch_size
        return with_online(cls, settings.online_share, batch)

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        return {"batch": random.integers(0, extent.size, (updates, self.batch_size))}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        return Selection(sampled["batch"], sampled["batch"])
