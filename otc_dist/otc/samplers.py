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
from typing import NamedTuple

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
    """What a learner holds of its own: packed rows, what its distance keeps beside them, and what
    its sampler has prepared.
    """

    rows: Tensor  # (capacity, width)
    features: Tensor  # (capacity, n); n = 0 where no distance keeps anything
    # (capacity,) 0 or 1, half of the episodes each; empty where nothing is fitted by halves
    folds: Tensor = torch.zeros(0, dtype=torch.int64)
    # By name, the same in all updates after one deployment: alpha, or scores of all rows.
    prepared: Mapping[str, Tensor] = MappingProxyType({})


class Held(NamedTuple):
    """What one agent holds when D_k has been merged, before the updates."""

    state: State  # the algorithm's
    data: Data
    extent: Extent
    engine: Engine
    random: Random  # keyed by this deployment as well
    kept: Mapping[str, float] = MappingProxyType(
        {}
    )  # `Begun.kept` of the deployment before, if any


class Begun(NamedTuple):
    """What a sampler made of a deployment's data before the updates."""

    data: Data
    changed: Mapping[str, Tensor] = MappingProxyType({})  # entries of the state, if it learns
    measured: Mapping[str, float] = MappingProxyType({})  # for people
    # Numbers to find again at the next deployment, also after a restart: alpha and similarity.
    kept: Mapping[str, float] = MappingProxyType({})


class Selection(NamedTuple):
    """What one update is given, and what choosing it changed."""

    rows: Tensor  # chosen row numbers (batch,), for values
    imitated: Tensor  # row numbers (batch,) for what imitates the data
    changed: Mapping[str, Tensor] = MappingProxyType({})  # entries of the state, if it learns
    metrics: Tensor | None = None  # the values of `Sampler.metric_names`; None: there are none


Indices = dict[str, NDArray[np.generic]]
Gathered = dict[str, Tensor]


class Sampler:
    """A sampling strategy. What one learns lies in the brain's state, under keys `sampler_*`.

    What it does not say is as of one that learns nothing and looks at no row that it draws.
    """

    @property
    def computes(self) -> bool:
        """Whether `select` computes so much that compiling it pays."""
        return False

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Names of the values in `Selection.metrics`."""
        return ()

    @property
    def kept(self) -> Mapping[str, float]:
        """What stands for `Begun.kept` before the first deployment."""
        return {}

    def noise(self) -> Mapping[str, Draw]:
        """The random arrays that one `select` needs beside its indices."""
        return {}

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        """Row numbers, or what they are chosen by, for `updates` updates: each (updates, n)."""
        raise NotImplementedError

    def begin(self, held: Held) -> Begun:
        """Prepare for the updates after a deployment, whose data have just been merged."""
        return Begun(held.data)

    def gather(self, state: State, data: Data, draws: Draws) -> Gathered:
        """What `select` looks at of the rows that one update drew, and of what `begin` prepared."""
        return {}

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        """The rows of one update, from its share of the draws."""
        raise NotImplementedError


@dataclass(frozen=True)
class Uniform(Sampler):
    """Uniform over the merged data B_k, or over the online data D_1 .. D_k only."""

    batch_size: int
    online_only: bool = False

    def draw(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        start = extent.offline if self.online_only else 0
        return {"batch": random.integers(start, extent.size, (updates, self.batch_size))}

    def select(self, state: State, gathered: Gathered, draws: Draws) -> Selection:
        return Selection(draws["batch"], draws["batch"])
