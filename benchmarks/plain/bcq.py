"""Plain BCQ."""

from copy import deepcopy

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from otc_dist.algorithms.bcq import BcqSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

from .parts import Minibatches, TwinCritics, follow, mlp, step


class PlainBcq:
    """BCQ after its authors' code."""

    def __init__(
        self, section: BcqSection, spec: AgentSpec, data: Transitions, *, fused: bool = False
    ) -> None:
        s, a, hidden = spec.observation_size, spec.action_size, section.hidden
        self.section, self.latent = section, 2 * a
        self.minibatches = Minibatches(data, section.batch_size)
        self.encoder = mlp(s + a, hidden, 2 * self.latent)
        self.decoder = mlp(s + self.latent, hidden, a)
        self.critics, self.actor = TwinCritics(s + a, hidden), mlp(s + a, hidden, a)
        self.target_critics, self.target_actor = deepcopy(self.critics), deepcopy(self.actor)
        vae = [*self.encoder.parameters(), *self.decoder.parameters()]
        adam = torch.optim.Adam
        self.vae_adam = adam(vae, section.vae_learning_rate, fused=fused)
        critic_rate, actor_rate = section.critic_learning_rate, section.actor_learning_rate
        self.critic_adam = adam(self.critics.parameters(), critic_rate, fused=fused)
        self.actor_adam = adam(self.actor.parameters(), actor_rate, fused=fused)

    def update(self) -> list[float]:
        settings = self.section
        s, a, r, next_s, done = self.minibatches.sample()

        mean, log_std = self.encoder(torch.cat((s, a), 1)).chunk(2, 1)
        std = log_std.clamp(-4, 15).exp()
        decoded = self.decode(s, mean + std * torch.randn_like(std))
        divergence = -0.5 * (1 + std.pow(2).log() - mean.pow(2) - std.pow(2)).mean()
        vae_loss = mse_loss(decoded, a) + 0.5 * divergence
        step(self.vae_adam, vae_loss)

        with torch.no_grad():
            repeated = next_s.repeat_interleave(settings.target_candidates, 0)
            actions = self.perturbed(self.target_actor, repeated, self.sample(repeated))
            q1, q2 = self.target_critics(repeated, actions)
            share = settings.soft_minimum
            mixed = share * torch.min(q1, q2) + (1 - share) * torch.max(q1, q2)
            best = mixed.view(len(s), settings.target_candidates).amax(1)
            target = r + settings.discount * (1 - done) * best
        q1, q2 = self.critics(s, a)
        critic_loss = mse_loss(q1, target) + mse_loss(q2, target)
        step(self.critic_adam, critic_loss)

        with torch.no_grad():
            sampled = self.sample(s)
        actor_loss = -self.critics.one(s, self.perturbed(self.actor, s, sampled)).mean()
        step(self.actor_adam, actor_loss)

        follow(self.target_critics, self.critics, settings.target_rate)
        follow(self.target_actor, self.actor, settings.target_rate)
        return [vae_loss.item(), critic_loss.item(), actor_loss.item()]

    def sample(self, s: Tensor) -> Tensor:
        return self.decode(s, torch.randn(len(s), self.latent).clamp(-0.5, 0.5))

    def decode(self, s: Tensor, z: Tensor) -> Tensor:
        decoded: Tensor = self.decoder(torch.cat((s, z), 1)).tanh()
        return decoded

    def perturbed(self, actor: nn.Module, s: Tensor, a: Tensor) -> Tensor:
        change: Tensor = self.section.perturbation * actor(torch.cat((s, a), 1)).tanh()
        return (a + change).clamp(-1, 1)
