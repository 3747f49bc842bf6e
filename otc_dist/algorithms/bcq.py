"""BCQ: batch-constrained deep Q-learning (Fujimoto, Meger and Precup, ICML 2019).

A conditional VAE imitates the behaviour policy; actions are decoded from it and perturbed a
little; twin critics choose among them. Constants follow the authors' code where Table 3 of the
OTC paper is silent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from otc_dist.algorithms.critics import ActorCritic, td_target
from otc_dist.algorithms.interface import Batch
from otc_dist.description.algorithms import AlgorithmSection, SmallSection
from otc_dist.steps.networks import Mlp, descend, fresh_state, polyak
from otc_dist.steps.noise import Noise, NoiseSpec
from otc_dist.steps.state import State
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

LATENT_CLIP = 0.5  # decoded actions use z ~ N(0, 1) clipped to +-0.5
LOG_STD_RANGE = (-4.0, 15.0)
KL_WEIGHT = 0.5


class BcqSection(SmallSection):
    """BCQ. What Table 3 leaves open is as in its authors' code."""

    update: ClassVar[float] = 1.0

    name: Literal["bcq"] = "bcq"
    actor_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    critic_learning_rate: float = Field(default=1e-4, gt=0, description="Table 3")
    vae_learning_rate: float = Field(
        default=1e-3, gt=0, description="not in Table 3: BCQ's own code"
    )
    target_candidates: int = Field(default=10, ge=1, description="actions decoded for a target")
    acting_candidates: int = Field(default=100, ge=1, description="actions decoded to act")
    perturbation: float = Field(default=0.05, ge=0, description="phi, in units of the action bound")
    soft_minimum: float = Field(
        default=0.75, ge=0, le=1, description="weight of min in 0.75 min + 0.25 max"
    )


@dataclass(frozen=True)
class Bcq(ActorCritic):
    """BCQ for one agent with continuous actions in [-1, 1]."""

    Section: ClassVar[type[AlgorithmSection]] = BcqSection

    settings: BcqSection

    metric_names: tuple[str, ...] = ("vae_loss", "critic_loss", "actor_loss", "q")

    @property
    def latent_size(self) -> int:
        return 2 * self.action_size

    @cached_property
    def encoder(self) -> Mlp:
        inputs = (self.observation_size, self.action_size)
        return Mlp(inputs, self.settings.hidden, 2 * self.latent_size)

    @cached_property
    def decoder(self) -> Mlp:
        inputs = (self.observation_size, self.latent_size)
        return Mlp(inputs, self.settings.hidden, self.action_size)

    @cached_property
    def actor(self) -> Mlp:
        inputs = (self.observation_size, self.action_size)
        return Mlp(inputs, self.settings.hidden, self.action_size)

    def initial_state(self, random: np.random.Generator, offline: Batch) -> dict[str, np.ndarray]:
        """Networks vae (encoder then decoder), critic and actor, the last two with targets."""
        vae = np.concatenate([self.encoder.initialise(random), self.decoder.initialise(random)])
        critic, actor = self.critics.initialise(random), self.actor.initialise(random)
        networks = {"vae": vae, "critic": critic, "actor": actor}
        return fresh_state(networks, targets=("critic", "actor"))

    def noise_spec(self, batch_size: int) -> Mapping[str, NoiseSpec]:
        latent, candidates = self.latent_size, self.settings.target_candidates
        return {
            "vae": NoiseSpec("normal", (batch_size, latent)),
            "target": NoiseSpec("normal", (batch_size, candidates, latent)),
            "actor": NoiseSpec("normal", (batch_size, latent)),
        }

    def update(
        self, state: State, batch: Batch, imitated: Batch, noise: Noise
    ) -> tuple[State, Tensor]:
        """One update of the VAE, then the critics, then the actor, in the authors' order.

        Each part sees the parameters that the part before it has just updated. The VAE alone
        imitates: fitted to rows chosen for their nearness to the agent's own newest ones, it would
        imitate the agent itself, and its spread would shrink from deployment to deployment.
        """
        new = dict(state, updates=state["updates"] + 1)

        new, vae_loss = descend(
            new,
            "vae",
            self.settings.vae_learning_rate,
            lambda vae: self.vae_loss(vae, imitated, noise["vae"]),
        )

        target = self.target(new, batch, noise["target"])
        new, critic_loss = self.fit_critics(new, batch, target)

        decoded = self.decode(new["vae"], batch.observation, noise["actor"])
        new, actor_loss = descend(
            new,
            "actor",
            self.settings.actor_learning_rate,
            lambda actor: self.actor_loss(actor, new["critic"], batch.observation, decoded),
        )

        rate = self.settings.target_rate
        new["critic_target"] = polyak(state["critic_target"], new["critic"], rate)
        new["actor_target"] = polyak(state["actor_target"], new["actor"], rate)
        return new, torch.stack((vae_loss, critic_loss, actor_loss, target.mean()))

    def vae_loss(self, vae: Tensor, batch: Batch, noise: Tensor) -> Tensor:
        """mean (a - a_hat)^2 + 0.5 KL(N(mu, sigma) || N(0, 1)), KL as a mean over elements."""
        encoder, decoder = self._split(vae)
        encoded = self.encoder.apply(encoder, batch.observation, batch.action)
        mean, log_std = encoded.chunk(2, dim=-1)
        log_std = log_std.clamp(*LOG_STD_RANGE)
        std = log_std.exp()
        decoded = self._decode(decoder, batch.observation, mean + std * noise)
        divergence = -0.5 * (1 + 2 * log_std - mean**2 - std**2).mean()
        return torch.nn.functional.mse_loss(decoded, batch.action) + KL_WEIGHT * divergence

    def target(self, state: State, batch: Batch, noise: Tensor) -> Tensor:
        """y = r + gamma max_{a'} [lambda min_j Q'_j(s', a') + (1 - lambda) max_j Q'_j(s', a')].

        The maximum is over `target_candidates` actions decoded by the VAE and perturbed by the
        target actor. At a terminal s', y = r.
        """
        s = batch.next_observation.unsqueeze(1)
        actions = self.perturb(state["actor_target"], s, self.decode(state["vae"], s, noise))
        q = self.critics.both(state["critic_target"], s, actions)
        soft = self.settings.soft_minimum
        mixed = soft * q.amin(0) + (1 - soft) * q.amax(0)
        return td_target(batch, self.settings.discount, mixed.amax(-1))

    def actor_loss(
        self, actor: Tensor, critic: Tensor, observations: Tensor, decoded: Tensor
    ) -> Tensor:
        """-mean Q_1(s, a + xi(s, a)) for decoded actions a, through which no gradient flows."""
        actions = self.perturb(actor, observations, decoded)
        return -self.critics.first(critic, observations, actions).mean()

    def decode(self, vae: Tensor, observations: Tensor, noise: Tensor) -> Tensor:
        """Actions decoded from standard normal `noise`, clipped as BCQ does."""
        _, decoder = self._split(vae)
        return self._decode(decoder, observations, noise.clamp(-LATENT_CLIP, LATENT_CLIP))

    def _split(self, vae: Tensor) -> tuple[Tensor, ...]:
        return torch.split(vae, [self.encoder.size, self.decoder.size])

    def _decode(self, decoder: Tensor, observations: Tensor, latent: Tensor) -> Tensor:
        """Actions in [-1, 1] decoded from latent vectors."""
        return self.decoder.apply(decoder, observations, latent).tanh()

    def perturb(self, actor: Tensor, observations: Tensor, actions: Tensor) -> Tensor:
        """clip(a + phi tanh(xi(s, a))), phi the perturbation."""
        change = self.settings.perturbation * self.actor.apply(actor, observations, actions).tanh()
        return (actions + change).clamp(-1, 1)

    def acting_noise_spec(self, copies: int) -> Mapping[str, NoiseSpec]:
        return {
            "act": NoiseSpec("normal", (copies, self.settings.acting_candidates, self.latent_size))
        }

    def act(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """The best by Q_1 of `acting_candidates` decoded and perturbed actions."""
        actions, q = self._candidates(state, observations, noise["act"])
        best = q.argmax(-1)
        return actions[torch.arange(actions.shape[0], device=actions.device), best]

    def value_noise_spec(self, count: int, samples: int) -> Mapping[str, NoiseSpec]:
        return {"value": NoiseSpec("normal", (count, samples, self.latent_size))}

    def value(self, state: State, observations: Tensor, noise: Noise) -> Tensor:
        """V(s): the mean of Q_1 over decoded and perturbed actions (B,)."""
        return self._candidates(state, observations, noise["value"])[1].mean(-1)

    def _candidates(
        self, state: State, observations: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Decoded and perturbed actions (B, n, a) and their Q_1 (B, n)."""
        s = observations.unsqueeze(1)
        actions = self.perturb(state["actor"], s, self.decode(state["vae"], s, noise))
        return actions, self.critics.first(state["critic"], s, actions)
