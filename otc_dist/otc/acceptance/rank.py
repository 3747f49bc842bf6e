"""Acceptance by rank, the paper's (Eq. 3): of a minibatch B, the nearer the likelier.

alpha says how much likelier. It exists here only, and so does its adaptation by Eq. 4.
"""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from otc_dist.algorithms.draws import Draw, Draws
from otc_dist.algorithms.interface import State
from otc_dist.description import SamplingSection
from otc_dist.otc.distances.interface import Distance, Matching
from otc_dist.otc.prioritization import prioritize
from otc_dist.otc.samplers import Begun, Data, Extent, Gathered, Held, Indices, Sampler, Selection


def create(distance: Distance, settings: SamplingSection, batch_size: int) -> Sampler:
    """By distances within the minibatches of an update where the distance can do that and the
    description asks for it; else by scores of all of B_k, computed once a deployment.
    """
    if isinstance(distance, Matching) and settings.matches_minibatches:
        return RankMatched(settings, batch_size, distance)
    return RankScored(settings, batch_size, distance)


@dataclass(frozen=True)
class _Rank:
    """B comes from B_k with replacement, in random order: ties in the rank fall at random."""

    settings: SamplingSection
    batch_size: int

    @property
    def computes(self) -> bool:
        return True

    def noise(self) -> dict[str, Draw]:
        return {"priority": Draw("exponential", (self.settings.candidates,))}

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        shape = (updates, self.settings.candidates)
        return {"candidates": random.integers(0, extent.size, shape)}

    def chosen(self, distances: Tensor, guarded: Tensor, draws: Draws) -> Selection:
        """By Eq. 3, from the distances (B,) of the candidates."""
        positions = prioritize(
            distances,
            draws["alpha"],
            draws["priority"],
            self.batch_size,
            with_replacement=self.settings.with_replacement,
        )
        rows = draws["candidates"][positions]
        return Selection(rows, rows, guarded)


@dataclass(frozen=True)
class RankMatched(_Rank):
    """Algorithm 1 as written: B is matched against D, which comes from D_k without replacement, in
    random order, so that ties in the match fall at random.

    D_k is part of B_k, so a transition may match itself (distance 0) unless
    `settings.exclude_self`.
    """

    distance: Matching

    def noise(self) -> dict[str, Draw]:
        return super().noise() | self.distance.noise(self.settings.candidates)

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        newest = np.arange(extent.newest, extent.size)
        references = len(newest)
        if self.settings.matching == "minibatch":
            references = min(self.settings.references, references)
        shuffled = random.permuted(np.broadcast_to(newest, (updates, len(newest))), axis=1)
        candidates = super().draw(random, updates, extent)
        return {**candidates, "references": shuffled[:, :references]}

    def begin(self, held: Held) -> Begun:
        similarity, guarded = self.distance.similarity(held)
        return Begun(held.data, measured={"similarity": similarity, "guarded": guarded})

    def gather(self, state: State, data: Data, draws: Draws) -> Gathered:
        names = ("candidates", "references")
        return {name: self.distance.gather(data, draws[name]) for name in names}

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        return self.chosen(*self.distances(state, gathered, draws), draws)

    def distances(self, state: State, gathered: Gathered, draws: Draws) -> tuple[Tensor, Tensor]:
        """d(s', s'*) (B,) of the candidates, and how many normalisers were guarded."""
        ids = (draws["candidates"], draws["references"]) if self.settings.exclude_self else None
        candidates, references = gathered["candidates"], gathered["references"]
        return self.distance.between(state, candidates, references, ids, draws)


@dataclass(frozen=True)
class RankScored(_Rank):
    """By scores of all of B_k, computed once a deployment; an update only looks them up."""

    distance: Distance

    def begin(self, held: Held) -> Begun:
        found = self.distance.scores(held, exclude_self=self.settings.exclude_self)
        similarity = float(found.values.double().mean())
        measured = {"similarity": similarity, "guarded": found.guarded}
        return Begun(held.data._replace(scores=found.values), measured=measured)

    def gather(self, state: State, data: Data, draws: Draws) -> Gathered:
        return {"distances": data.scores.index_select(0, draws["candidates"])}

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        distances = gathered["distances"]
        return self.chosen(distances, distances.new_zeros(()), draws)
