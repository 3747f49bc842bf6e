"""CQL: conservative Q-learning for continuous actions (Kumar, Zhou, Tucker and Levine, NeurIPS
2020), the variant CQL(H) with a fixed weight.

Soft actor-critic whose critics are also pushed down wherever they are high and up on the data.
The equations and the constants that Table 3 of the OTC paper leaves open follow the authors' code
(aviralkumar2907/CQL, its settings for MuJoCo) as it is run without a Lagrange multiplier: the
backed-up value has no entropy term. Unlike there, the policy is not warmed up by behaviour cloning,
and networks see standardised states, both as in CORL.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from otc_dist.algorithms.critics import StandardisedActorCritic, td_target
from otc_dist.algorithms.gaussian import mode_squashed, sample_squashed
from otc_dist.algorithms.interface import Batch
from otc_dist.description.algorithms import AlgorithmSection, LargeSection
from otc_dist.steps.networks import Mlp, descend, fresh_state, polyak
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

LOG_STD_RANGE = (-5.0, 2.0)
PARTS = 4  # the critics judge thousands of actions: of so many parts of a batch, one at a time


class CqlSection(LargeSection):
    """CQL for continuous actions. What Table 3 leaves open is as in its authors' code, but that
    states are standardised and the actor is not warmed up by imitation, as in CORL.
    """

    update: ClassVar[float] = 18.0

    name: Literal["cql"] = "cql"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")
    weight: float = Field(
        default=10.0, ge=0, description="w of the conservative term (its authors: 5 or 10)"
    )
    action_samples: int = Field(
        default=10, ge=1, description="actions of each kind in the conservative term"
    )


@dataclass(frozen=True)
class Cql(StandardisedActorCritic):
    """CQL for one agent with continuous actions in [-1, 1].

    The temperature learns at the actor's rate, as in the authors' code.
    """

    Section: ClassVar[type[AlgorithmSection]] = CqlSection

    settings: CqlSection

    metric_names: tuple[str, ...] = ("critic_loss", "actor_loss", "temperature", "q")

    @cached_property
    def actor(self) -> Mlp:
        return Mlp((self.observation_size,), self.settings.hidden, 2 * self.action_size)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """Networks actor and critic, the latter with a target, log_temperature (1,), and the
        `statistics` of B_0.
        """
        actor, critic = self.actor.initialise(random), self.critics.initialise(random)
        networks = {"actor": actor, "critic": critic, "log_temperature": np.zeros(1)}
        return {**fresh_state(networks, targets=("critic",)), **self.statistics(offline)}

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        one = (batch_size, self.action_size)
        several = (self.settings.action_samples, self.action_size)
        return {
            "actor": NoiseSpec("normal", one),
            "target": NoiseSpec("normal", one),
            "random": NoiseSpec("uniform", (batch_size, *several)),
            "current": NoiseSpec("normal", (batch_size, *several)),
            "next": NoiseSpec("normal", (batch_size, *several)),
        }

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        """One update of the temperature, the actor and the critics, in the authors' order.

        The actor sees the new temperature; otherwise all see the state before the update.
        """
        new = dict(state, updates=state["updates"] + 1)
        batch = self.standardised_batch(state, batch)
        states = torch.stack((batch.observation, batch.next_observation))
        means, log_stds = self.policy(state["actor"], states)
        here, there = (means[0], log_stds[0]), (means[1], log_stds[1])

        _, log_density = sample_squashed(*here, noise["actor"])
        new, _ = descend(
            new,
            "log_temperature",
            self.settings.actor_learning_rate,
            lambda log_temperature: self.temperature_loss(log_temperature, log_density),
        )
        temperature = new["log_temperature"].exp()

        new, actor_loss = descend(
            new,
            "actor",
            self.settings.actor_learning_rate,
            lambda actor: self.actor_loss(
                actor, state["critic"], temperature, batch.observation, noise["actor"]
            ),
        )

        target = self.target(state, batch, there, noise["target"])
        new, critic_loss = descend(
            new,
            "critic",
            self.settings.critic_learning_rate,
            *self.critic_losses(batch, target, *self.candidates(here, there, noise)),
        )
        rate = self.settings.target_rate
        new["critic_target"] = polyak(state["critic_target"], new["critic"], rate)
        return new, torch.stack((critic_loss, actor_loss, temperature[0], target.mean()))

    def policy(self, actor: Tensor, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation (..., a) of the action before tanh, in standardised s."""
        mean, log_std = self.actor.apply(actor, observations).chunk(2, dim=-1)
        return mean, log_std.clamp(*LOG_STD_RANGE)

    def temperature_loss(self, log_temperature: Tensor, log_density: Tensor) -> Tensor:
        """-log(temperature) mean(log pi(a|s) + H), with the target entropy H = -a_size."""
        return -(log_temperature * (log_density - self.action_size)).mean()

    def actor_loss(
        self,
        actor: Tensor,
        critic: Tensor,
        temperature: Tensor,
        observations: Tensor,
        noise: Tensor,
    ) -> Tensor:
        """mean [temperature log pi(a|s) - min_j Q_j(s, a)], a ~ pi(s) (Haarnoja et al., 2018)."""
        actions, log_density = sample_squashed(*self.policy(actor, observations), noise)
        q = self.critics.minimum(critic, observations, actions)
        return (temperature * log_density - q).mean()

    def target(
        self, state: State, batch: Batch, there: tuple[Tensor, Tensor], noise: Tensor
    ) -> Tensor:
        """y = r + gamma min_j Q'_j(s', a'), a' ~ pi(s'). At a terminal s', y = r.

        Args:
            there: the policy's mean and log standard deviation in s'.
        """
        actions, _ = sample_squashed(*there, noise)
        q = self.critics.minimum(state["critic_target"], batch.next_observation, actions)
        return td_target(batch, self.settings.discount, q)

    def candidates(
        self, here: tuple[Tensor, Tensor], there: tuple[Tensor, Tensor], noise: Noise
    ) -> tuple[Tensor, Tensor]:
        """Actions of the conservative term (B, 3n, a) and their log densities (B, 3n).

        n uniform ones, n of the policy in s, and n of the policy in s' (all judged in s).
        """
        uniform = 2 * noise["random"] - 1
        uniform_density = torch.full_like(uniform[..., 0], -self.action_size * math.log(2))
        current, current_density = _sample_several(here, noise["current"])
        following, following_density = _sample_several(there, noise["next"])
        return (
            torch.cat((uniform, current, following), 1),
            torch.cat((uniform_density, current_density, following_density), 1),
        )

    def critic_losses(
        self, batch: Batch, target: Tensor, actions: Tensor, log_density: Tensor
    ) -> list[Callable[[Tensor], Tensor]]:
        """The shares in the critics' loss of PARTS parts of the batch, as functions of them."""
        parts = [array.chunk(PARTS) for array in (*batch, target, actions, log_density)]

        def share(*part: Tensor) -> Callable[[Tensor], Tensor]:
            *fields, y, a, density = part
            weight = len(y) / len(target)
            return lambda critic: weight * self.critic_loss(critic, Batch(*fields), y, a, density)

        return [share(*part) for part in zip(*parts, strict=True)]

    def critic_loss(
        self, critic: Tensor, batch: Batch, target: Tensor, actions: Tensor, log_density: Tensor
    ) -> Tensor:
        """Sum over the twins of  mean (Q_j(s, a) - y)^2 + w mean [log sum_i exp(Q_j(s, a_i)
        - log p(a_i)) - Q_j(s, a)], over the candidates a_i of density p (eq. 4 with the
        importance weights of the paper's experiments; their number is left out of the sum, as in
        the authors' code, and changes no gradient).
        """
        judged = torch.cat((batch.action.unsqueeze(1), actions), 1)
        q = self.critics.both(critic, batch.observation.unsqueeze(1), judged)
        q_data, q_candidates = q[..., 0], q[..., 1:]
        bellman = ((q_data - target) ** 2).mean(-1)
        gap = (torch.logsumexp(q_candidates - log_density, -1) - q_data).mean(-1)
        return (bellman + self.settings.weight * gap).sum()

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        return {}

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """The squashed mean of the policy."""
        s = self.standardised(state, observations)
        return mode_squashed(self.policy(state["actor"], s)[0])

    def value_noise_spec(self, count: int, samples: int) -> Mapping[str, NoiseSpec]:
        return {"value": NoiseSpec("normal", (count, samples, self.action_size))}

    def value(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """V(s): the mean of Q_1 over actions sampled from the policy (B,)."""
        s = self.standardised(state, observations).unsqueeze(1)
        actions, _ = sample_squashed(*self.policy(state["actor"], s), noise["value"])
        return self.critics.first(state["critic"], s, actions).mean(-1)


def _sample_several(policy: tuple[Tensor, Tensor], noise: Tensor) -> tuple[Tensor, Tensor]:
    """Actions (B, n, a) and log densities (B, n) of one policy (B, a) a row, by noise (B, n, a)."""
    mean, log_std = policy
    return sample_squashed(mean.unsqueeze(1), log_std.unsqueeze(1), noise)
