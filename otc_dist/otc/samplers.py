"""Sampling strategies: which transitions of B_k an update sees (Algorithm 1, lines 10 to 14).

A sampler draws row numbers outside, for many updates at once (`draw`), gathers what it must
look at (`gather`), and chooses by a pure function of it (`select`), which the engine runs.
Gathering stays apart because a compiler that fuses it into the distance computation reads the
buffer at random once for every pair: ten times slower. What depends on a deployment only is
computed once, before its updates (`begin`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from otc_dist.algorithms.draws import Draw, Draws
from otc_dist.algorithms.interface import State
from otc_dist.engine import Engine

Random = Callable[..., np.random.Generator]  # a stream for a key


class Extent(NamedTuple):
    """Which rows are what: B_0 is [0, offline), D_k is [newest, size), B_k is [0, size)."""

    offline: int
    newest: int
    size: int


class Data(NamedTuple):
    """What a learner holds of its own: packed rows, and what its distance keeps beside them."""

    rows: Tensor  # (capacity, width)
    features: Tensor  # (capacity, n); n = 0 where no distance keeps anything
    # (capacity,) 0 or 1, half of the episodes each; empty where nothing is fitted by halves
    folds: Tensor = torch.zeros(0, dtype=torch.int64)
    scores: Tensor = torch.zeros(0)  # (n,) of this deployment; empty where they change with updates


class Held(NamedTuple):
    """What one agent holds when D_k has been merged, before the updates."""

    state: State  # the algorithm's
    data: Data
    extent: Extent
    engine: Engine
    random: Random  # keyed by this deployment as well


class Begun(NamedTuple):
    """What a sampler made of a deployment's data before the updates."""

    data: Data
    changed: Mapping[str, Tensor] = MappingProxyType({})  # entries of the state, if it learns
    measured: Mapping[str, float] = MappingProxyType({})  # for people, and for Eq. 4


class Selection(NamedTuple):
    """What one update is given, and what choosing it changed."""

    rows: Tensor  # chosen row numbers (batch,), for values
    imitated: Tensor  # row numbers (batch,) for what imitates the data
    guarded: Tensor  # how many normalisers were guarded (float scalar)
    changed: Mapping[str, Tensor] = MappingProxyType({})  # entries of the state, if it learns


Indices = dict[str, NDArray[np.generic]]
Gathered = dict[str, Tensor]


class Sampler(Protocol):
    """A sampling strategy. What one learns lies in the brain's state, under keys `sampler_*`."""

    @property
    def computes(self) -> bool:
        """Whether `select` computes so much that compiling it pays."""
        ...

    def noise(self) -> dict[str, Draw]:
        """The random arrays that one `select` needs beside its indices."""
        ...

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        """Row numbers, or what they are chosen by, for `updates` updates: each (updates, n)."""
        ...

    def begin(self, held: Held) -> Begun:
        """Prepare for the updates after a deployment, whose data have just been merged."""
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

    @property
    def computes(self) -> bool:
        return False

    def noise(self) -> dict[str, Draw]:
        return {}

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        start = extent.offline if self.online_only else 0
        return {"batch": random.integers(start, extent.size, (updates, self.batch_size))}

    def begin(self, held: Held) -> Begun:
        return Begun(held.data)

    def gather(self, state: State, data: Data, draws: Draws) -> Gathered:
        return {}

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        batch = draws["batch"]
        return Selection(batch, batch, torch.zeros((), device=batch.device))
