"""Samplers made of others: online data beside what is chosen, and a plain sample to imitate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from otc_dist.otc.data import Data


@dataclass(frozen=True)
class SamplerWrapper(Sampler):
    """Another sampler, as it is. Those below change what they are named for."""

    inner: Sampler

    @property
    def computes(self) -> bool:
        return self.inner.computes

    @property
    def metric_names(self) -> tuple[str, ...]:
        return self.inner.metric_names

    @property
    def kept(self) -> Mapping[str, float]:
        return self.inner.kept

    def noise_spec(self) -> Mapping[str, NoiseSpec]:
        return self.inner.noise_spec()

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        return self.inner.sample_indices(random, updates, extent)

    def begin(self, held: MergedData) -> Preparation:
        return self.inner.begin(held)

    def gather(self, state: State, data: Data, sampled: Noise) -> Gathered:
        return self.inner.gather(state, data, sampled)

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        return self.inner.select(state, gathered, sampled)


@dataclass(frozen=True)
class WithOnline(SamplerWrapper):
    """`count` transitions of D_1 .. D_k in every batch, beside those of the inner sampler: for
    half of a batch, RLPD's symmetric sampling (Ball et al., ICML 2023).
    """

    count: int

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        chosen = self.inner.sample_indices(random, updates, extent)
        online = random.integers(extent.offline, extent.size, (updates, self.count))
        return {**chosen, "online": online}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        chosen, online = self.inner.select(state, gathered, sampled), sampled["online"]
        return chosen._replace(
            rows=torch.cat((chosen.rows, online)), imitated=torch.cat((chosen.imitated, online))
        )


@dataclass(frozen=True)
class ImitatingAll(SamplerWrapper):
    """What imitates the data is given a uniform sample of B_k instead of what is chosen."""

    batch_size: int

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        chosen = self.inner.sample_indices(random, updates, extent)
        return {**chosen, "plain": random.integers(0, extent.size, (updates, self.batch_size))}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        return self.inner.select(state, gathered, sampled)._replace(imitated=sampled["plain"])


def with_online(choose: Callable[[int], Sampler], share: float, batch_size: int) -> Sampler:
    """A sampler of whole batches, of which a share is online data.

    Args:
        choose: makes what chooses so many transitions, the rest of a batch.
    """
    online = round(share * batch_size)
    chosen = choose(batch_size - online)
    return WithOnline(chosen, online) if online else chosen
