"""Plain CQL for continuous actions."""

import math
from copy import deepcopy

import torch
from torch import Tensor
from torch.distributions import Normal, TanhTransform, TransformedDistribution
from torch.nn.functional import mse_loss

from otc_dist.algorithms.cql import CqlSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

from .parts import Minibatches, TwinCritics, follow, mlp, step


class PlainCql:
    """CQL(H) with a fixed weight and a tuned temperature."""

    def __init__(self, section: CqlSection, spec: AgentSpec, data: Transitions) -> None:
        s, a, hidden = spec.observation_size, spec.action_size, section.hidden
        self.section, self.action_size = section, a
        self.minibatches = Minibatches(data, section.batch_size)
        self.minibatches.standardise()
        self.actor, self.critics = mlp(s, hidden, 2 * a), TwinCritics(s + a, hidden)
        self.target_critics = deepcopy(self.critics)
        self.log_temperature = torch.zeros(1, requires_grad=True)
        adam = torch.optim.Adam
        self.temperature_adam = adam([self.log_temperature], section.actor_learning_rate)
        self.actor_adam = adam(self.actor.parameters(), section.actor_learning_rate)
        self.critic_adam = adam(self.critics.parameters(), section.critic_learning_rate)

    def update(self) -> list[float]:
        s, a, r, next_s, done = self.minibatches.sample()

        chosen, log_density = self.sample(s)
        surplus = (log_density - self.action_size).detach()
        temperature_loss = -(self.log_temperature * surplus).mean()
        step(self.temperature_adam, temperature_loss)
        temperature = self.log_temperature.exp().detach()
        actor_loss = (temperature * log_density - torch.min(*self.critics(s, chosen))).mean()
        critic_loss = self.critic_loss(s, a, r, next_s, done)
        step(self.actor_adam, actor_loss)
        step(self.critic_adam, critic_loss)
        follow(self.target_critics, self.critics, self.section.target_rate)
        return [temperature_loss.item(), actor_loss.item(), critic_loss.item()]

    def critic_loss(self, s: Tensor, a: Tensor, r: Tensor, next_s: Tensor, done: Tensor) -> Tensor:
        samples = self.section.action_samples
        with torch.no_grad():
            target = torch.min(*self.target_critics(next_s, self.sample(next_s)[0]))
            target = r + self.section.discount * (1 - done) * target
            uniform = torch.empty(len(s), samples, self.action_size).uniform_(-1, 1)
            current, current_density = self.sample(s.unsqueeze(1).repeat(1, samples, 1))
            following, next_density = self.sample(next_s.unsqueeze(1).repeat(1, samples, 1))
        repeated = s.unsqueeze(1).repeat(1, samples, 1)
        loss = torch.zeros(())
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
            loss = loss + mse_loss(data_q, target) + self.section.weight * gap
        return loss

    def sample(self, s: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_std = self.actor(s).chunk(2, -1)
        normal = Normal(mean, log_std.clamp(-5, 2).exp())
        policy = TransformedDistribution(normal, TanhTransform(cache_size=1))
        actions = policy.rsample()
        return actions, policy.log_prob(actions).sum(-1)
