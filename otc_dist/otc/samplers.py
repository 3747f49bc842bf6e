"""Sampling strategies: which transitions of B_k an update sees (Algorithm 1, lines 10 to 14).

A sampler draws row numbers outside, for many updates at once (`draw`), gathers what it must
look at (`gather`), and chooses by a pure function of it (`select`), which the engine runs.
Gathering stays apart because a compiler that fuses it into the distance computation reads the
buffer at random once for every pair: ten times slower.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from otc_dist.algorithms.draws import Draw, Draws
from otc_dist.algorithms.interface import Critic, State, unpack
from otc_dist.description import SamplingSection
from otc_dist.otc.changes import matched_size
from otc_dist.otc.distances import match_values, matched_l1, nearest_l1, next_state_distance
from otc_dist.otc.prioritization import prioritize
from otc_dist.transitions import RowLayout


class Extent(NamedTuple):
    """Which rows are what: B_0 is [0, offline), D_k is [newest, size), B_k is [0, size)."""

    offline: int
    newest: int
    size: int


class Data(NamedTuple):
    """What a learner holds of its own: packed rows, and their embeddings where d_e is used, or
    their features where d_c is.
    """

    rows: Tensor  # (capacity, width)
    embeddings: Tensor  # (capacity, e); e = 0 with d_q and without OTC


class Selection(NamedTuple):
    """What one update is given, and what choosing it changed."""

    rows: Tensor  # chosen row numbers (batch,)
    guarded: Tensor  # how many normalisers were guarded (float scalar)
    changed: Mapping[str, Tensor] = MappingProxyType({})  # entries of the state, if it learns


Indices = dict[str, NDArray[np.int64]]
Gathered = dict[str, Tensor]


class Sampler(Protocol):
    """A sampling strategy. What one learns lies in the brain's state, under keys `sampler_*`."""

    def noise(self) -> dict[str, Draw]:
        """The random arrays that one `select` needs beside its indices."""
        ...

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        """Row numbers for `updates` updates, each array (updates, n)."""
        ...

    def begin(self, state: State, extent: Extent, random: np.random.Generator) -> State:
        """The sampler's entries of the state when D_k has been merged, before its L updates."""
        ...

    def gather(self, state: State, data: Data, draws: Draws) -> Gathered:
        """What `select` looks at of the rows that one update drew."""
        ...

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        """The rows of one update, from its share of the draws and alpha (scalar)."""
        ...


@dataclass(frozen=True)
class Uniform:
    """Uniform over the merged data B_k, or over the online data D_1 .. D_k only."""

    batch_size: int
    online_only: bool = False

    def noise(self) -> dict[str, Draw]:
        return {}

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        start = extent.offline if self.online_only else 0
        return {"batch": random.integers(start, extent.size, (updates, self.batch_size))}

    def begin(self, state: State, extent: Extent, random: np.random.Generator) -> State:
        return {}

    def gather(self, state: State, data: Data, draws: Draws) -> Gathered:
        return {}

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        return Selection(draws["batch"], torch.zeros((), device=draws["batch"].device))


def feature_distances(
    settings: SamplingSection,
    layout: RowLayout,
    queries: Tensor,
    references: Tensor,
    ids: tuple[Tensor, Tensor] | None,
) -> Tensor:
    """d_e, or d_c, (B,) of the rows of `Data.embeddings` that are `queries`, (B, F)."""
    if settings.distance == "embedding":
        return nearest_l1(queries, references, ids)
    return matched_l1(queries, references, matched_size(layout), ids)


@dataclass(frozen=True)
class Otc:
    """Online transition correction: rank-based prioritization by transition similarity.

    B comes from B_k with replacement; D from D_k without, in random order, so that ties in the
    match and in the rank fall at random. D_k is part of B_k, so a transition may match itself
    (distance 0) unless `settings.exclude_self`.
    """

    critic: Critic | None
    layout: RowLayout
    settings: SamplingSection
    batch_size: int

    def noise(self) -> dict[str, Draw]:
        draws = {"priority": Draw("exponential", (self.settings.candidates,))}
        if self.settings.distance == "value":
            draws.update(
                self._critic.value_noise(self.settings.candidates, self.settings.value_samples)
            )
        return draws

    @property
    def _critic(self) -> Critic:
        assert self.critic is not None  # a description without a Q does not ask for d_q
        return self.critic

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        newest = np.arange(extent.newest, extent.size)
        references = len(newest)
        if self.settings.matching == "minibatch":
            references = min(self.settings.references, references)
        shuffled = random.permuted(np.broadcast_to(newest, (updates, len(newest))), axis=1)
        return {
            "candidates": random.integers(0, extent.size, (updates, self.settings.candidates)),
            "references": shuffled[:, :references],
        }

    def begin(self, state: State, extent: Extent, random: np.random.Generator) -> State:
        return {}

    def gather(self, state: State, data: Data, draws: Draws) -> Gathered:
        source = data.rows if self.settings.distance == "value" else data.embeddings
        return {name: source.index_select(0, draws[name]) for name in ("candidates", "references")}

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        distances, guarded = self.distances(state, gathered, draws)
        chosen = prioritize(
            distances,
            draws["alpha"],
            draws["priority"],
            self.batch_size,
            with_replacement=self.settings.with_replacement,
        )
        return Selection(draws["candidates"][chosen], guarded)

    def distances(self, state: State, gathered: Gathered, draws: Draws) -> tuple[Tensor, Tensor]:
        """d(s', s'*) (B,) of the candidates, and how many normalisers were guarded."""
        candidates, references = gathered["candidates"], gathered["references"]
        ids = (draws["candidates"], draws["references"]) if self.settings.exclude_self else None
        if self.settings.distance != "value":
            near = feature_distances(self.settings, self.layout, candidates, references, ids)
            return near, near.new_zeros(())
        batch, online = unpack(candidates, self.layout), unpack(references, self.layout)
        matches = match_values(
            self._critic.q(state, batch.observation, batch.action),
            self._critic.q(state, online.observation, online.action),
            ids,
        )
        # Both values by the same noise: less noise in their difference.
        values = self._values(state, batch.next_observation, batch.terminated, draws)
        matched = self._values(
            state, online.next_observation[matches], online.terminated[matches], draws
        )
        return next_state_distance(values, matched, self.settings.normaliser)

    def _values(self, state: State, states: Tensor, terminated: Tensor, draws: Draws) -> Tensor:
        """V(s') (B,), 0 at a terminal s'."""
        return torch.where(terminated > 0, 0.0, self._critic.value(state, states, draws))
