"""Plain BCQ."""

from collections.abc import Mapping, Sequence
from copy import deepcopy

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from otc_dist.algorithms.bcq import BcqSection

from .parts import TwinCritics, follow, mlp, step


class PlainBcq:
    """BCQ of Fujimoto, Meger and Precup, 2019: their Algorithm 1 with their code's constants."""

    standardised = False

    def __init__(
        self,
        section: BcqSection,
        s: int,
        a: int,
        dtype: torch.dtype = torch.float32,
        *,
        fused: bool = False,
    ) -> None:
        hidden = section.hidden
        self.section, self.latent = section, 2 * a
        self.encoder = mlp(s + a, hidden, 2 * self.latent, dtype)
        self.decoder = mlp(s + self.latent, hidden, a, dtype)
        self.critics, self.actor = TwinCritics(s + a, hidden, dtype), mlp(s + a, hidden, a, dtype)
        self.target_critics, self.target_actor = deepcopy(self.critics), deepcopy(self.actor)
        vae = [*self.encoder.parameters(), *self.decoder.parameters()]
        adam = torch.optim.Adam
        self.vae_adam = adam(vae, section.vae_learning_rate, fused=fused)
        critic_rate, actor_rate = section.critic_learning_rate, section.actor_learning_rate
        self.critic_adam = adam(self.critics.parameters(), critic_rate, fused=fused)
        self.actor_adam = adam(self.actor.parameters(), actor_rate, fused=fused)

    def sample_noise(self, count: int) -> dict[str, Tensor]:
        return {
            "vae": torch.randn(count, self.latent),
            "target": torch.randn(count, self.section.target_candidates, self.latent),
            "actor": torch.randn(count, self.latent),
        }

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """The losses of the VAE, the critics and the actor, and the mean target."""
        settings = self.section
        s, a, r, next_s, done = batch

        mean, log_std = self.encoder(torch.cat((s, a), 1)).chunk(2, 1)
        std = log_std.clamp(-4, 15).exp()
        decoded = self.decode(s, mean + std * noise["vae"])
        divergence = -0.5 * (1 + std.pow(2).log() - mean.pow(2) - std.pow(2)).mean()
        vae_loss = mse_loss(decoded, a) + 0.5 * divergence
        step(self.vae_adam, vae_loss)

        with torch.no_grad():
            q1, q2 = self.target_critics(
                *self.candidates(self.target_actor, next_s, noise["target"])
            )
            share = settings.soft_minimum
            mixed = share * torch.min(q1, q2) + (1 - share) * torch.max(q1, q2)
            best = mixed.view(len(s), -1).amax(1)
            target = r + settings.discount * (1 - done) * best
        q1, q2 = self.critics(s, a)
        critic_loss = mse_loss(q1, target) + mse_loss(q2, target)
        step(self.critic_adam, critic_loss)

        with torch.no_grad():
            sampled = self.decode(s, noise["actor"].clamp(-0.5, 0.5))
        actor_loss = -self.critics.one(s, self.perturbed(self.actor, s, sampled)).mean()
        step(self.actor_adam, actor_loss)

        follow(self.target_critics, self.critics, settings.target_rate)
        follow(self.target_actor, self.actor, settings.target_rate)
        return [x.item() for x in (vae_loss, critic_loss, actor_loss, target.mean())]

    def decode(self, s: Tensor, z: Tensor) -> Tensor:
        decoded: Tensor = self.decoder(torch.cat((s, z), 1)).tanh()
        return decoded

    def perturbed(self, actor: nn.Module, s: Tensor, a: Tensor) -> Tensor:
        change: Tensor = self.section.perturbation * actor(torch.cat((s, a), 1)).tanh()
        return (a + change).clamp(-1, 1)

    def candidates(self, actor: nn.Module, s: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """States repeated (B n, s) and perturbed actions (B n, a), for noise (B, n, latent)."""
        repeated = s.repeat_interleave(noise.shape[1], 0)
        sampled = self.decode(repeated, noise.flatten(0, 1).clamp(-0.5, 0.5))
        return repeated, self.perturbed(actor, repeated, sampled)

    def value(self, s: Tensor, noise: Tensor) -> Tensor:
        """The mean of Q_1 over decoded and perturbed actions (B,)."""
        return self.critics.one(*self.candidates(self.actor, s, noise)).view(len(s), -1).mean(1)

    def act(self, s: Tensor, noise: Tensor) -> Tensor:
        """Of the decoded and perturbed actions the best by Q_1 (B, a)."""
        repeated, actions = self.candidates(self.actor, s, noise)
        best = self.critics.one(repeated, actions).view(len(s), -1).argmax(1)
        return actions.view(len(s), -1, actions.shape[1])[range(len(s)), best]
