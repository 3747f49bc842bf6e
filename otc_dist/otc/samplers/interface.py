"""Sampling strategies: which transitions of B_k an update sees (Algorithm 1, lines 10 to 14).

A sampler samples row numbers outside, for many updates at once (`sample_indices`), gathers what
it must look at (`gather`), and chooses by a pure function of it (`select`), which the engine runs.
Gathering stays apart because a compiler that fuses it into the distance computation reads the
buffer at random once for every pair: ten times slower. What depends only on a deployment is
computed once, before its updates (`begin`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State

if TYPE_CHECKING:
    from torch import Tensor

    from otc_dist.description import SamplingSection
    from otc_dist.otc.data import Data
    from otc_dist.otc.distances.interface import Setting
    from otc_dist.steps.engine import Engine

Random = Callable[..., np.random.Generator]  # a stream for a key


class Extent(NamedTuple):
    """Which rows are what: B_0 is [0, offline), D_k is [newest, size), B_k is [0, size)."""

    offline: int
    newest: int
    size: int


class MergedData(NamedTuple):
    """What one agent holds when D_k has been merged, before the updates."""

    state: State  # the algorithm's
    data: Data
    extent: Extent
    engine: Engine
    random: Random  # keyed by this deployment as well
    # `Preparation.kept` of the deployment before, if any.
    kept: Mapping[str, float] = MappingProxyType({})


class Preparation(NamedTuple):
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
Gathered = dict[str, "Tensor"]


class Sampler(ABC):
    """A sampling strategy. What one learns lies in the learner's state, under keys `sampler_*`.

    `sample_indices` and `select` are its own. The other methods are, where it does not define them,
    those of one that learns nothing and looks at none of the rows that it draws.

    Attributes:
        Section: the class of its settings. Samplers that no description names have none.
    """

    Section: ClassVar[type[SamplingSection]]

    @classmethod
    def create(cls, settings: Any, setting: Setting, capacity: int) -> Sampler:
        """The strategy of one agent, for a replay buffer of `capacity` rows.

        Args:
            settings: of the strategy's own `Section`.
        """
        return cls(settings, setting.description.algorithm.batch_size)  # type: ignore[call-arg]

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
        """What stands for `Preparation.kept` before the first deployment."""
        return {}

    def noise_spec(self) -> Mapping[str, NoiseSpec]:
        """The random arrays that one `select` needs beside its indices."""
        return {}

    @abstractmethod
    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        """Row numbers, or what they are chosen by, for `updates` updates: each (updates, n).

        Rows from `extent.size` on hold nothing yet.
        """

    def begin(self, held: MergedData) -> Preparation:
        """Prepare for the updates after a deployment, whose data have just been merged."""
        return Preparation(held.data)

    def gather(self, state: State, data: Data, sampled: Noise) -> Gathered:
        """What `select` looks at of the rows that one update drew, and of what `begin` prepared."""
        return {}

    @abstractmethod
    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        """The rows of one update, from its share of what was sampled: row numbers and noise."""

    def weights(self, state: State, size: int) -> Tensor:
        """How likely each of the rows 0 .. size - 1 is drawn, by what was learned so far (size,).

        Asked of those with a `SamplingSection.row`.
        """
        raise NotImplementedError
