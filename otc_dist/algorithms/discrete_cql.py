"""CQL for discrete actions with masks (Kumar, Zhou, Tucker and Levine, NeurIPS 2020).

Double deep Q-learning whose Q is also pushed down over all available actions and up on the
data's. As in the published codes (aviralkumar2907/CQL for Atari, d3rlpy's DiscreteCQL) there is
one Q, no twins, the temporal difference is under Huber's loss, and the conservative term's weight
is 1. Unlike there, the target network follows slowly instead of being copied every some thousand
updates, which one deployment's tuning may not reach; and Q gives means, as d3rlpy's, not
quantiles.

The masks lie in the tails of s and s' (`AgentSpec.choices`). Q also sees them as inputs: what is
available now is part of what the agent observes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from otc_dist.algorithms.critics import td_target
from otc_dist.algorithms.interface import Batch
from otc_dist.description.algorithms import AlgorithmSection, LargeSection
from otc_dist.steps.networks import Mlp, descend, fresh_state, polyak
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor


class DiscreteCqlSection(LargeSection):
    """CQL for discrete actions."""

    discrete: ClassVar[bool] = True
    update: ClassVar[float] = 1.1

    name: Literal["discrete-cql"] = "discrete-cql"
    critic_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")
    weight: float = Field(
        default=1.0, ge=0, description="alpha of the conservative term, as in the published codes"
    )


@dataclass(frozen=True)
class DiscreteCql:
    """Discrete CQL for one agent, whose actions are indices.

    Attributes:
        observation_size: the agent's own, with the mask.
        action_size: number of actions to choose from, the mask's length.
    """

    Section: ClassVar[type[AlgorithmSection]] = DiscreteCqlSection

    observation_size: int
    action_size: int
    settings: DiscreteCqlSection

    metric_names: tuple[str, ...] = ("critic_loss", "q")

    @cached_property
    def critic(self) -> Mlp:
        return Mlp((self.observation_size,), self.settings.hidden, self.action_size)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """The network critic, with a target."""
        return fresh_state({"critic": self.critic.initialise(random)}, targets=("critic",))

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        return {}

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        """One update of the critic."""
        target = self.target(state, batch)
        new, loss = descend(
            {**state, "updates": state["updates"] + 1},
            "critic",
            self.settings.critic_learning_rate,
            lambda critic: self.critic_loss(critic, batch, target),
        )
        rate = self.settings.target_rate
        new["critic_target"] = polyak(state["critic_target"], new["critic"], rate)
        return new, torch.stack((loss, target.mean()))

    def target(self, state: State, batch: Batch) -> Tensor:
        """y = r + gamma Q'(s', argmax_a' Q(s', a')) over the available a' (van Hasselt, Guez and
        Silver, AAAI 2016). At a terminal s', y = r.
        """
        s = batch.next_observation
        best = self.greedy(state["critic"], s)
        return td_target(
            batch, self.settings.discount, _at(self.critic.apply(state["critic_target"], s), best)
        )

    def critic_loss(self, critic: Tensor, batch: Batch, target: Tensor) -> Tensor:
        """mean Huber(Q(s, a) - y) + alpha mean [log sum_i exp Q(s, a_i) - Q(s, a)], the sum over
        the available actions a_i (eq. 4 of the paper).
        """
        values = self.critic.apply(critic, batch.observation)
        q = _at(values, batch.action)
        gap = torch.logsumexp(self.masked(values, batch.observation), -1) - q
        return torch.nn.functional.smooth_l1_loss(q, target) + self.settings.weight * gap.mean()

    def masked(self, values: Tensor, observations: Tensor) -> Tensor:
        """Values (..., n) of the available actions, and -infinity for the others.

        Where none is available, which only a terminal s' may say, all count as available: its
        value is multiplied by 0, and must be a number for that.
        """
        available = observations[..., -self.action_size :] > 0
        available = available | ~available.any(-1, keepdim=True)
        return torch.where(available, values, -torch.inf)

    def greedy(self, critic: Tensor, observations: Tensor) -> Tensor:
        """Indices (..., 1) of the best available actions."""
        values = self.critic.apply(critic, observations)
        return self.masked(values, observations).argmax(-1, keepdim=True)

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        return {}

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """The best available action's index."""
        return self.greedy(state["critic"], observations).to(observations.dtype)

    def q(self, state: State, observations: Tensor, actions: Tensor) -> Tensor:
        return _at(self.critic.apply(state["critic"], observations), actions)

    def value_noise_spec(self, count: int, samples: int) -> Mapping[str, NoiseSpec]:
        return {}

    def value(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """V(s): the greatest Q of an available action (B,)."""
        values = self.critic.apply(state["critic"], observations)
        return self.masked(values, observations).amax(-1)


def _at(values: Tensor, actions: Tensor) -> Tensor:
    """The value (B,) among values (B, n) at each index (B, 1), which may be a float."""
    return values.gather(-1, actions.long()).squeeze(-1)
