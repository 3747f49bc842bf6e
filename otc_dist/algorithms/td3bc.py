"""TD3+BC (Fujimoto and Gu, NeurIPS 2021): TD3 whose policy is also held to the data's actions.

Constants follow the authors' code where Table 3 of the OTC paper is silent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from otc_dist.algorithms.critics import StandardisedActorCritic, td_target
from otc_dist.algorithms.interface import Batch
from otc_dist.description.algorithms import AlgorithmSection, LargeSection
from otc_dist.steps.networks import Mlp, descend, fresh_state, polyak, when
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

TARGET_NOISE = 0.2  # standard deviation of the noise on a', in units of the action bound
NOISE_CLIP = 0.5
POLICY_DELAY = 2  # updates of the critics to one of the policy and of all targets


class Td3BcSection(LargeSection):
    """TD3+BC. What Table 3 leaves open is as in its authors' code."""

    update: ClassVar[float] = 1.6

    name: Literal["td3bc"] = "td3bc"
    actor_learning_rate: float = Field(default=3e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=3e-4, gt=0, description="Table 3")
    target_rate: float = Field(default=0.005, gt=0, le=1, description="tau of the target networks")
    q_weight: float = Field(
        default=2.5, ge=0, description="alpha, weight of Q against imitation of the data"
    )


@dataclass(frozen=True)
class Td3Bc(StandardisedActorCritic):
    """TD3+BC for one agent with continuous actions in [-1, 1]."""

    Section: ClassVar[type[AlgorithmSection]] = Td3BcSection

    settings: Td3BcSection

    metric_names: tuple[str, ...] = ("critic_loss", "actor_loss", "q")

    @cached_property
    def actor(self) -> Mlp:
        return Mlp((self.observation_size,), self.settings.hidden, self.action_size)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """Networks critic and actor with targets, and the `statistics` of B_0."""
        networks = {
            "critic": self.critics.initialise(random),
            "actor": self.actor.initialise(random),
        }
        return {
            **fresh_state(networks, targets=("critic", "actor")),
            **self.statistics(offline),
        }

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        return {"target": NoiseSpec("normal", (batch_size, self.action_size))}

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        """One update of the critics, and, at every POLICY_DELAY-th, of the actor and all targets.

        The actor's loss is of the critics just updated, and both its terms are of the imitated
        batch: they are weighed in the same states. It counts POLICY_DELAY times where there
        is one and 0 elsewhere, so that its mean over updates is its mean over the actor's.
        """
        new = dict(state, updates=state["updates"] + 1)
        batch = self.standardised_batch(state, batch)
        imitated = self.standardised_batch(state, imitated)

        target = self.target(state, batch, noise["target"])
        new, critic_loss = self.fit_critics(new, batch, target)

        changing = ("actor", "actor_moments", "critic_target", "actor_target")
        *changed, actor_loss = when(
            new["updates"] % POLICY_DELAY == 0,
            lambda: self._improve(new, imitated, changing),
            (*(state[name] for name in changing), torch.zeros_like(critic_loss)),
        )
        new.update(zip(changing, changed, strict=True))
        return new, torch.stack((critic_loss, actor_loss, target.mean()))

    def _improve(self, state: State, batch: Batch, changing: tuple[str, ...]) -> tuple[Tensor, ...]:
        """One step of the actor and then of the targets: the tensors `changing`, and the loss."""
        counted = dict(state, updates=state["updates"] / POLICY_DELAY)
        new, loss = descend(
            counted,
            "actor",
            self.settings.actor_learning_rate,
            lambda actor: self.actor_loss(actor, state["critic"], batch),
        )
        for name in ("critic", "actor"):
            target = f"{name}_target"
            new[target] = polyak(state[target], new[name], self.settings.target_rate)
        return *(new[name] for name in changing), POLICY_DELAY * loss

    def target(self, state: State, batch: Batch, noise: Tensor) -> Tensor:
        """y = r + gamma min_j Q'_j(s', a'),  a' = clip(pi'(s') + clip(0.2 eps, +-0.5)) (B,)."""
        s = batch.next_observation
        smoothing = (TARGET_NOISE * noise).clamp(-NOISE_CLIP, NOISE_CLIP)
        actions = (self._action(state["actor_target"], s) + smoothing).clamp(-1, 1)
        return td_target(
            batch, self.settings.discount, self.critics.minimum(state["critic_target"], s, actions)
        )

    def actor_loss(self, actor: Tensor, critic: Tensor, batch: Batch) -> Tensor:
        """-lambda mean Q_1(s, pi(s)) + mean (pi(s) - a)^2,  lambda = alpha / mean |Q_1(s, pi(s))|.

        No gradient flows through lambda.
        """
        actions = self._action(actor, batch.observation)
        q = self.critics.first(critic, batch.observation, actions)
        scale = self.settings.q_weight / q.abs().mean().detach()
        return torch.nn.functional.mse_loss(actions, batch.action) - scale * q.mean()

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        return {}

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """pi(s)."""
        return self._action(state["actor"], self.standardised(state, observations))

    def value_noise_spec(self, count: int, samples: int) -> Mapping[str, NoiseSpec]:
        return {}

    def value(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """V(s) = Q_1(s, pi(s)) (B,): the policy is deterministic."""
        return self.q(state, observations, self.act(state, observations, noise))

    def _action(self, actor: Tensor, standardised: Tensor) -> Tensor:
        return self.actor.apply(actor, standardised).tanh()
