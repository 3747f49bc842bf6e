"""Balanced Replay (Lee et al., Offline-to-Online RL via Balanced Replay, CoRL 2021).

Transitions are drawn in proportion to how near to the online data their (s, a) is: a network
w(s, a) learns the ratio of the online to the offline density, and the priority of a transition is
w^(1/T) over its mean in B_0. Unlike OTC it never looks at s', so it cannot distinguish dynamics.

Constants follow the authors' code (github.com/shlee94/Off2OnRL). Two things differ from it: w is
made positive by a softplus, whose gradient never vanishes, where they use a ReLU; and D_k arrives
at once, so the priority of new transitions follows from the share they are to have (`begin`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field, PositiveInt

from otc_dist.algorithms.interface import action_features, unpack
from otc_dist.description.sampling import Arm, Cost, SamplingSection
from otc_dist.otc.samplers import priorities
from otc_dist.otc.samplers.interface import (
    Extent,
    Gathered,
    Indices,
    MergedData,
    Preparation,
    Sampler,
    Selection,
)
from otc_dist.steps.networks import Mlp, adam, value_and_gradient
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State
from otc_dist.system.lazy import torch
from otc_dist.transitions import RowLayout

if TYPE_CHECKING:
    from torch import Tensor

    from otc_dist.otc.data import Data
    from otc_dist.otc.distances.interface import Setting

ONLINE_SHARE = 0.5  # of D_k in the first minibatches after a deployment (init_online_fraction)
PRIORITY_RANGE = (1e-3, 1e3)
TINY = 1e-10  # inside logarithms and quotients, as in the authors' code
EVEN = math.log(math.e - 1)  # softplus(EVEN) = 1: at first both densities count as equal


class BalancedSection(SamplingSection):
    """Balanced Replay."""

    arms: ClassVar[Mapping[str, Arm]] = {
        "balanced": Arm(
            ("sampling.name=balanced",),
            "Balanced Replay, by how near to the online data (s, a) is",
        )
    }
    row: ClassVar[str] = "Balanced Replay"
    bound: ClassVar[bool] = True

    name: Literal["balanced"] = "balanced"
    density_hidden: tuple[PositiveInt, ...] = Field(
        default=(64, 64),
        description="hidden layers of Balanced Replay's w(s, a); its authors' are (256, 256)",
    )
    density_learning_rate: float = Field(
        default=1e-3,
        gt=0,
        description="of w(s, a); its authors' is 3e-4 (docs/method.md compares both networks)",
    )
    temperature: float = Field(
        default=5.0, gt=0, description="T: Balanced Replay's priorities are w(s, a)^(1/T)"
    )

    @property
    def cost(self) -> Cost:
        return Cost(update=0.4)


@dataclass(frozen=True)
class Balanced(Sampler):
    """Balanced Replay over B_k.

    What it learns lies in the state: `sampler_density` (n,), its `_moments` (2, n), the number of
    `sampler_updates`, and `sampler_priorities` with `sampler_sums` (priorities.py).

    Attributes:
        capacity: rows of the replay buffer, filled or not.
    """

    Section: ClassVar[type[SamplingSection]] = BalancedSection

    settings: BalancedSection
    layout: RowLayout
    batch_size: int
    capacity: int

    @classmethod
    def create(cls, settings: BalancedSection, setting: Setting, capacity: int) -> Sampler:
        return cls(settings, setting.layout, setting.description.algorithm.batch_size, capacity)

    @cached_property
    def density(self) -> Mlp:
        actions = self.layout.choices or self.layout.action_size
        return Mlp((self.layout.observation_size, actions), self.settings.density_hidden, 1)

    @property
    def computes(self) -> bool:
        return True

    def noise_spec(self) -> dict[str, NoiseSpec]:
        return {"priority": NoiseSpec("uniform", (self.batch_size,))}

    def sample_indices(self, random: np.random.Generator, updates: int, extent: Extent) -> Indices:
        """Uniform minibatches of B_0 and of D_1 .. D_k, from which w learns."""
        shape = (updates, self.batch_size)
        return {
            "offline": random.integers(0, extent.offline, shape),
            "online": random.integers(extent.offline, extent.size, shape),
        }

    def begin(self, held: MergedData) -> Preparation:
        """Give D_k its priority, and at the first deployment a fresh w and priority 1 to B_0.

        p_new = f / (1 - f) * (sum of the priorities of B_{k-1}) / |D_k|, so that D_k is the share
        f = ONLINE_SHARE of the first minibatches. With priorities of 1 this is the authors'
        f |B_0| / ((1 - f) N) for their N = 1000 new transitions. Each keeps it until drawn once.
        """
        extent, device = held.extent, held.data.rows.device
        mine = {key: value for key, value in held.state.items() if key.startswith("sampler_")}
        mine = mine or self._fresh(extent, held.random("sampler"), device)
        each = ONLINE_SHARE / (1 - ONLINE_SHARE) * mine["sampler_sums"].sum()
        each = each / (extent.size - extent.newest)
        filled = priorities.fill(mine["sampler_priorities"], extent.newest, extent.size, each)
        return Preparation(held.data, mine | _named(filled))

    def gather(self, state: State, data: Data, sampled: Noise) -> Gathered:
        chosen = priorities.choose(*_priorities(state), sampled["priority"])
        numbers = torch.cat((sampled["offline"], sampled["online"], chosen))
        return {"numbers": chosen, "rows": data.rows.index_select(0, numbers)}

    def select(self, state: State, gathered: Gathered, sampled: Noise) -> Selection:
        """The rows drawn by priority. w takes one step, and their priorities are set anew:
        w(s, a)^(1/T) / mean over the offline minibatch of w^(1/T), by w before the step.
        """
        density, numbers = state["sampler_density"], gathered["numbers"]
        offline, online, chosen = gathered["rows"].chunk(3)
        updates = state["sampler_updates"] + 1
        _, gradient = value_and_gradient(
            lambda density: self.loss(density, offline, online), density
        )
        moments, rate = state["sampler_density_moments"], self.settings.density_learning_rate
        trained, moments = adam(density, gradient, moments, updates, rate)
        root = 1 / self.settings.temperature
        level = (self.ratio(density, offline) ** root).mean() + TINY
        found = (self.ratio(density, chosen) ** root / level).clamp(*PRIORITY_RANGE)
        held = state["sampler_priorities"].view(-1)[numbers]
        found = torch.where(found.isnan(), held, found)
        changed = {
            "sampler_density": trained,
            "sampler_density_moments": moments,
            "sampler_updates": updates,
            **_named(priorities.replace(*_priorities(state), numbers, found)),
        }
        return Selection(numbers, numbers, changed)

    def weights(self, state: State, size: int) -> Tensor:
        return state["sampler_priorities"].view(-1)[:size]

    def loss(self, density: Tensor, offline: Tensor, online: Tensor) -> Tensor:
        """mean [-log(2 / (w_off + 1)) - log(2 w_on / (w_on + 1))], whose minimum is reached by
        w = density of the online over density of the offline data (the variational form of the
        Jensen-Shannon divergence).

        Args:
            density: parameters of w (n,).
            offline, online: packed rows (B, width).
        """
        w_off, w_on = self.ratio(density, offline), self.ratio(density, online)
        divergence = (2 / (w_off + 1) + TINY).log() + (2 * w_on / (w_on + 1) + TINY).log()
        return -divergence.mean()

    def ratio(self, density: Tensor, rows: Tensor) -> Tensor:
        """w(s, a) (B,) of packed rows (B, width), above 0. A discrete action is one-hot."""
        batch = unpack(rows, self.layout)
        action = action_features(batch.action, self.layout.choices)
        logits = EVEN + self.density.apply(density, batch.observation, action).squeeze(-1)
        return torch.nn.functional.softplus(logits)

    def _fresh(self, extent: Extent, random: np.random.Generator, device: torch.device) -> State:
        network = self.density.initialise(random).astype(np.float32)
        density = torch.from_numpy(network).to(device)
        held = priorities.fill(priorities.empty(self.capacity, device), 0, extent.newest, 1.0)
        return {
            "sampler_density": density,
            "sampler_density_moments": torch.zeros(2, len(density), device=device),
            "sampler_updates": torch.zeros((), dtype=torch.float64, device=device),
            **_named(held),
        }


def _priorities(state: State) -> tuple[Tensor, Tensor]:
    return state["sampler_priorities"], state["sampler_sums"]


def _named(held: tuple[Tensor, Tensor]) -> State:
    return dict(zip(("sampler_priorities", "sampler_sums"), held, strict=True))
