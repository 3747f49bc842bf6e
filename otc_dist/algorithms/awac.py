"""AWAC: advantage-weighted actor-critic (Nair, Gupta, Dalal and Levine, 2020).

Twin critics learn the policy's action value; the policy imitates the data's actions, each the more
the better the critics find it. Two published forms differ in the weights: the authors' (rlkit)
takes a softmax of the advantages over the minibatch, CORL's their clamped exponential. From CORL
comes also that networks see standardised states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from otc_dist.algorithms.critics import StandardisedActorCritic, td_target
from otc_dist.algorithms.gaussian import log_density
from otc_dist.algorithms.interface import Batch
from otc_dist.description.algorithms import AlgorithmSection, SmallSection
from otc_dist.steps.networks import Mlp, descend, fresh_state, polyak
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

LOG_STD_RANGE = (-6.0, 0.0)  # the authors', for actions in [-1, 1]
LARGEST_WEIGHT = 100.0  # CORL's bound on exp(A / temperature)


class AwacSection(SmallSection):
    """AWAC. What Table 3 leaves open is as in its authors' code, but for the temperature, and that
    states are standardised, as in CORL.
    """

    update: ClassVar[float] = 0.6

    name: Literal["awac"] = "awac"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=5e-4, gt=0, description="Table 3")
    weighting: Literal["softmax", "exponential"] = Field(
        default="softmax", description="softmax over the minibatch (rlkit) or exp up to 100 (CORL)"
    )
    temperature: float = Field(
        default=10.0, gt=0, description="of the advantages, in units of Q (rlkit: 2, CORL: 1)"
    )


@dataclass(frozen=True)
class Awac(StandardisedActorCritic):
    """AWAC for one agent with continuous actions in [-1, 1]."""

    Section: ClassVar[type[AlgorithmSection]] = AwacSection

    settings: AwacSection

    metric_names: tuple[str, ...] = ("critic_loss", "actor_loss", "q")

    @cached_property
    def actor(self) -> Mlp:
        return Mlp((self.observation_size,), self.settings.hidden, self.action_size)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """Networks critic, with a target, and actor: its mean's network, then its log-std logits.

        The logits start at 0, the middle of LOG_STD_RANGE. And the `statistics` of B_0.
        """
        critic = self.critics.initialise(random)
        actor = np.concatenate([self.actor.initialise(random), np.zeros(self.action_size)])
        networks = fresh_state({"critic": critic, "actor": actor}, targets=("critic",))
        return {**networks, **self.statistics(offline)}

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        shape = (batch_size, self.action_size)
        return {"target": NoiseSpec("normal", shape), "actor": NoiseSpec("normal", shape)}

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        """One update of the critics and of the actor.

        As in the authors' code, both losses are of the parameters before the update.
        """
        new = dict(state, updates=state["updates"] + 1)
        batch = self.standardised_batch(state, batch)
        imitated = self.standardised_batch(state, imitated)

        target = self.target(state, batch, noise["target"])
        new, critic_loss = self.fit_critics(new, batch, target)

        weights = self.weights(self.advantages(state, imitated, noise["actor"]))
        new, actor_loss = descend(
            new,
            "actor",
            self.settings.actor_learning_rate,
            lambda actor: self.actor_loss(actor, imitated, weights),
        )

        rate = self.settings.target_rate
        new["critic_target"] = polyak(state["critic_target"], new["critic"], rate)
        return new, torch.stack((critic_loss, actor_loss, target.mean()))

    def target(self, state: State, batch: Batch, noise: Tensor) -> Tensor:
        """y = r + gamma min_j Q'_j(s', a'), a' ~ pi(s'), without an entropy term (B,)."""
        s = batch.next_observation
        actions = self.sample(state["actor"], s, noise)
        return td_target(
            batch, self.settings.discount, self.critics.minimum(state["critic_target"], s, actions)
        )

    def advantages(self, state: State, batch: Batch, noise: Tensor) -> Tensor:
        """A(s, a) = min_j Q_j(s, a) - min_j Q_j(s, a~), a~ ~ pi(s) (B,)."""
        s, critic = batch.observation, state["critic"]
        sampled = self.sample(state["actor"], s, noise)
        value = self.critics.minimum(critic, s, sampled)
        return self.critics.minimum(critic, s, batch.action) - value

    def weights(self, advantages: Tensor) -> Tensor:
        """Weights (B,) of the data's actions, at temperature T.

        "softmax": B softmax(A / T), whose mean is 1; "exponential": min(exp(A / T), 100).
        """
        scaled = advantages / self.settings.temperature
        if self.settings.weighting == "softmax":
            return len(scaled) * scaled.softmax(0)
        return scaled.exp().clamp(max=LARGEST_WEIGHT)

    def actor_loss(self, actor: Tensor, batch: Batch, weights: Tensor) -> Tensor:
        """-mean w log pi(a | s), through whose weights no gradient flows."""
        mean, log_std = self.policy(actor, batch.observation)
        return -(weights * log_density(batch.action, mean, log_std)).mean()

    def policy(self, actor: Tensor, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Mean (..., a) = tanh(mu(s)) and log standard deviation (a,), the same in all states."""
        size, (low, high) = self.actor.size, LOG_STD_RANGE
        mean = self.actor.apply(actor[:size], observations).tanh()
        return mean, low + (high - low) * actor[size:].sigmoid()

    def sample(self, actor: Tensor, observations: Tensor, noise: Tensor) -> Tensor:
        """Actions of the policy from standard normal noise (..., a).

        They are clipped to [-1, 1], as in CORL and as any environment does it; rlkit would ask
        the critics for values of actions that nobody can take.
        """
        mean, log_std = self.policy(actor, observations)
        return (mean + log_std.exp() * noise).clamp(-1, 1)

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        return {}

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """The policy's mean action."""
        return self.policy(state["actor"], self.standardised(state, observations))[0]

    def value_noise_spec(self, count: int, samples: int) -> Mapping[str, NoiseSpec]:
        return {"value": NoiseSpec("normal", (count, samples, self.action_size))}

    def value(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """V(s): the mean of Q_1 over sampled actions of the policy (B,)."""
        s = self.standardised(state, observations).unsqueeze(1)
        actions = self.sample(state["actor"], s, noise["value"])
        return self.critics.first(state["critic"], s, actions).mean(-1)
