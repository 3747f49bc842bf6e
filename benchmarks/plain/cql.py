"""Plain CQL for continuous actions."""

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy

import torch
from torch import Tensor, nn
from torch.distributions import Normal, TanhTransform, TransformedDistribution
from torch.nn.functional import mse_loss

from otc_dist.algorithms.cql import CqlSection

from .parts import TwinCritics, follow, mlp, several, step


class PlainCql:
    """CQL(H) of Kumar et al., 2020, with a fixed weight, a tuned temperature, and no entropy in
    the backup.
    """

    standardised = True

    def __init__(
        self, section: CqlSection, s: int, a: int, dtype: torch.dtype = torch.float32
    ) -> None:
        hidden = section.hidden
        self.section, self.action_size = section, a
        self.actor, self.critics = mlp(s, hidden, 2 * a, dtype), TwinCritics(s + a, hidden, dtype)
        self.target_critics = deepcopy(self.critics)
        self.log_temperature = nn.Parameter(torch.zeros(1, dtype=dtype))
        adam = torch.optim.Adam
        self.temperature_adam = adam([self.log_temperature], section.actor_learning_rate)
        self.actor_adam = adam(self.actor.parameters(), section.actor_learning_rate)
        self.critic_adam = adam(self.critics.parameters(), section.critic_learning_rate)

    def sample_noise(self, count: int) -> dict[str, Tensor]:
        several = (count, self.section.action_samples, self.action_size)
        return {
            "actor": torch.randn(count, self.action_size),
            "target": torch.randn(count, self.action_size),
            "random": torch.rand(several),
            "current": torch.randn(several),
            "next": torch.randn(several),
        }

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """The critics' and the actor's loss, the temperature and the mean target."""
        s, _, r, next_s, done = batch

        chosen, log_density = self.sample(s, noise["actor"])
        surplus = (log_density - self.action_size).detach()
        temperature_loss = -(self.log_temperature * surplus).mean()
        step(self.temperature_adam, temperature_loss)
        temperature = self.log_temperature.exp().detach()
        actor_loss = (temperature * log_density - torch.min(*self.critics(s, chosen))).mean()

        with torch.no_grad():
            next_a, _ = self.sample(next_s, noise["target"])
            target = torch.min(*self.target_critics(next_s, next_a))
            target = r + self.section.discount * (1 - done) * target
        critic_loss = self.critic_loss(batch, target, noise)
        step(self.actor_adam, actor_loss)
        step(self.critic_adam, critic_loss)

        follow(self.target_critics, self.critics, self.section.target_rate)
        return [x.item() for x in (critic_loss, actor_loss, temperature, target.mean())]

    def critic_loss(
        self, batch: Sequence[Tensor], target: Tensor, noise: Mapping[str, Tensor]
    ) -> Tensor:
        s, a, _, next_s, _ = batch
        repeated = several(s, self.section.action_samples)
        with torch.no_grad():
            uniform = 2 * noise["random"] - 1
            current, current_density = self.sample(repeated, noise["current"])
            repeated_next = several(next_s, self.section.action_samples)
            following, next_density = self.sample(repeated_next, noise["next"])
        losses = []
        for data_q, uniform_q, current_q, next_q in zip(
            self.critics(s, a),
            self.critics(repeated, uniform),
            self.critics(repeated, current),
            self.critics(repeated, following),
            strict=True,
        ):
            parts = (
                uniform_q + self.action_size * math.log(2),
                next_q - next_density,
                current_q - current_density,
            )
            gap = (torch.logsumexp(torch.cat(parts, 1), 1) - data_q).mean()
            losses.append(mse_loss(data_q, target) + self.section.weight * gap)
        return losses[0] + losses[1]

    def sample(self, s: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Actions for noise (..., a), and their log densities (...)."""
        mean, log_std = self.actor(s).chunk(2, -1)
        normal = Normal(mean, log_std.clamp(-5, 2).exp())
        squash = TanhTransform(cache_size=1)  # keeps what it squashed, instead of inverting tanh
        actions = squash(normal.mean + normal.stddev * noise)
        density = TransformedDistribution(normal, squash).log_prob(actions)
        return actions, density.sum(-1)

    def value(self, s: Tensor, noise: Tensor) -> Tensor:
        """The mean of Q_1 over actions of the policy (B,), for noise (B, n, a)."""
        repeated = several(s, noise.shape[1])
        return self.critics.one(repeated, self.sample(repeated, noise)[0]).mean(1)

    def act(self, s: Tensor) -> Tensor:
        mean: Tensor = self.actor(s)[:, : self.action_size]
        return mean.tanh()
