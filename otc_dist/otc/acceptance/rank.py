"""Acceptance by rank, the paper's (Eq. 3): of a minibatch B, the nearer the likelier.

alpha says how much likelier. It exists here only, and so does its adaptation by Eq. 4.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from otc_dist.otc.alpha import Alpha
from otc_dist.otc.data import Data
from otc_dist.otc.distances.interface import Distance, Matching, scored
from otc_dist.otc.prioritization import prioritize
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

log = logging.getLogger(__name__)


def create(distance: Distance, settings: CorrectionSection, batch_size: int) -> Sampler:
    """By distances within the minibatches of an update where the distance can do that and the
    description asks for it; else by scores of all of B_k, computed once a deployment.
    """
    if isinstance(distance, Matching) and settings.matches_minibatches:
        return RankMatched(settings, batch_size, distance)
    return RankScored(settings, batch_size, distance)


@dataclass(frozen=True)
class _Rank(Sampler):
    """B comes from B_k with replacement, in random order: ties in the rank fall at random."""

    settings: CorrectionSection
    batch_size: int

    @property
    def computes(self) -> bool:
        return True

    @property
    def kept(self) -> Mapping[str, float]:
        return _kept(Alpha(self.settings.alpha))

    def noise_spec(self) -> dict[str, NoiseSpec]:
        return {"priority": NoiseSpec("exponential", (self.settings.candidates,))}

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        shape = (updates, self.settings.candidates)
        return {"candidates": random.integers(0, extent.size, shape)}

    def begun(
        self, held: MergedData, similarity: float, guarded: float, **prepared: Tensor
    ) -> Preparation:
        """With alpha_k by Eq. 4 from 𝔻_k, and what else is `prepared`."""
        kept, settings = held.kept or self.kept, self.settings
        alpha = Alpha(kept["alpha"], kept["similarity"])
        if settings.adaptive:
            alpha = alpha.adapt(similarity, settings.alpha_bound)
            if alpha.value == settings.alpha_bound > 0:
                log.warning("sampling.alpha_bound binds: alpha is %g", alpha.value)
        value = torch.tensor(alpha.value, dtype=torch.float32, device=held.data.rows.device)
        return Preparation(
            held.data._replace(prepared={"alpha": value, **prepared}),
            measured={"alpha": alpha.value, "similarity": similarity, "guarded": guarded},
            kept=_kept(alpha),
        )

    def chosen(self, distances: Tensor, alpha: Tensor, sampled: Noise) -> Tensor:
        """Row numbers by Eq. 3, from the distances (B,) of the candidates."""
        positions = prioritize(
            distances,
            alpha,
            sampled["priority"],
            self.batch_size,
            with_replacement=self.settings.with_replacement,
        )
        return sampled["candidates"][positions]


def _kept(alpha: Alpha) -> Mapping[str, float]:
    return {"alpha": alpha.value, "similarity": alpha.similarity}


@dataclass(frozen=True)
class RankMatched(_Rank):
    """Algorithm 1 as written: B is matched against D, which comes from D_k without replacement, in
    random order, so that ties in the match fall at random.

    D_k is part of B_k, so a transition may match itself (distance 0) unless
    `settings.exclude_self`.
    """

    distance: Matching

    @property
    def metric_names(self) -> tuple[str, ...]:
        return ("guarded",)  # normalisers that were guarded

    def noise_spec(self) -> dict[str, NoiseSpec]:
        return super().noise_spec() | self.distance.noise_spec(self.settings.candidates)

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        newest = np.arange(extent.newest, extent.size)
        references = len(newest)
        if self.settings.matching == "minibatch":
            references = min(self.settings.references, references)
        shuffled = random.permuted(np.broadcast_to(newest, (updates, len(newest))), axis=1)
        candidates = super().sample_indices(random, updates, extent)
        return {**candidates, "references": shuffled[:, :references]}

    def begin(self, held: MergedData) -> Preparation:
        return self.begun(held, *self.distance.similarity(held))

    def gather(self, state: State, data: Data, sampled: Noise) -> Gathered:
        return {**self.pairs(data, sampled), "alpha": data.prepared["alpha"]}

    def pairs(self, data: Data, sampled: Noise) -> Gathered:
        """What the distance looks at of both minibatches."""
        names = ("candidates", "references")
        return {name: self.distance.gather(data, sampled[name]) for name in names}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        distances, guarded = self.distances(state, gathered, sampled)
        rows = self.chosen(distances, gathered["alpha"], sampled)
        return Selection(rows, rows, metrics=guarded.view(1))

    def distances(self, state: State, gathered: Gathered, sampled: Noise) -> tuple[Tensor, Tensor]:
        """d(s', s'*) (B,) of the candidates, and how many normalisers were guarded."""
        ids = (sampled["candidates"], sampled["references"]) if self.settings.exclude_self else None
        candidates, references = gathered["candidates"], gathered["references"]
        return self.distance.between(state, candidates, references, ids, sampled)


@dataclass(frozen=True)
class RankScored(_Rank):
    """By scores of all of B_k, computed once a deployment; an update only looks them up."""

    distance: Distance

    def begin(self, held: MergedData) -> Preparation:
        found = scored(self.distance, held, exclude_self=self.settings.exclude_self)
        similarity = float(found.values.double().mean())
        return self.begun(held, similarity, found.guarded, scores=found.values)

    def gather(self, state: State, data: Data, sampled: Noise) -> Gathered:
        scores, alpha = data.prepared["scores"], data.prepared["alpha"]
        return {"distances": scores.index_select(0, sampled["candidates"]), "alpha": alpha}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        rows = self.chosen(gathered["distances"], gathered["alpha"], sampled)
        return Selection(rows, rows)
