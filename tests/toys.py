"""One of a user's own of each kind that a description can choose: a module that knows the package
and is none of it. Tests copy it to where a user would have it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from otc_dist.algorithms.interface import Batch
from otc_dist.description.algorithms import AlgorithmSection
from otc_dist.description.distances import DistanceFacts
from otc_dist.description.sampling import SamplingSection
from otc_dist.otc.acceptance.weighted import Weighted
from otc_dist.otc.distances.interface import Distance, Scores, Setting
from otc_dist.otc.samplers.correction import CorrectionSection
from otc_dist.otc.samplers.interface import (
    Extent,
    Gathered,
    Indices,
    MergedData,
    Preparation,
    Sampler,
    Selection,
)
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State


class CloningSection(AlgorithmSection):
    has_q: ClassVar[bool] = False
    tuning_updates: ClassVar[int] = 10

    rate: float = Field(default=0.1, gt=0)
    note: str | None = None


@dataclass(frozen=True)
class Cloning:
    """The data's actions as a linear function of the observation."""

    Section: ClassVar[type[AlgorithmSection]] = CloningSection

    observation_size: int
    action_size: int
    settings: CloningSection

    metric_names: tuple[str, ...] = ("loss",)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        weight = np.zeros((self.observation_size, self.action_size), np.float32)
        return {"weight": weight, "updates": np.zeros(())}

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        return {}

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        error = imitated.observation @ state["weight"] - imitated.action
        slope = imitated.observation.T @ error / len(error)
        weight = state["weight"] - self.settings.rate * slope
        new = {**state, "weight": weight, "updates": state["updates"] + 1}
        return new, error.square().mean().view(1)

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        return {}

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        return (observations @ state["weight"]).clamp(-1, 1)


class RecentSection(SamplingSection):
    span: int = Field(default=50, ge=1)


@dataclass(frozen=True)
class Recent(Sampler):
    """The last `span` transitions; it counts the deployments."""

    Section: ClassVar[type[SamplingSection]] = RecentSection

    settings: RecentSection
    batch_size: int

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        first = extent.size - self.settings.span
        return {"batch": random.integers(first, extent.size, (updates, self.batch_size))}

    def begin(self, held: MergedData) -> Preparation:
        seen = held.state.get("sampler_seen", torch.zeros(()))
        return Preparation(held.data, {"sampler_seen": seen + 1})

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        return Selection(sampled["batch"], sampled["batch"])


@dataclass(frozen=True)
class Late:
    """A distance: the later in B_k, the nearer."""

    facts: ClassVar[DistanceFacts] = DistanceFacts("toys:Late", "late", "how long ago it was")

    @classmethod
    def create(cls, setting: Setting) -> "Late":
        return cls()

    def scores(self, held: MergedData, *, exclude_self: bool) -> Scores:
        return Scores(-torch.arange(held.extent.size).float())


def half(distance: Distance, settings: CorrectionSection, batch_size: int) -> Sampler:
    """A rule of acceptance: the nearer half."""
    return Weighted(settings, batch_size, distance, _nearer)


def _nearer(settings: CorrectionSection, scores: Tensor, extent: Extent) -> Tensor:
    return (scores <= scores.median()).float()
