"""Plain AWAC."""

from copy import deepcopy

import torch
from torch import Tensor, nn
from torch.distributions import Normal
from torch.nn.functional import mse_loss

from otc_dist.algorithms.awac import AwacSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

from .parts import Minibatches, TwinCritics, follow, mlp, step


class PlainAwac:
    """AWAC with softmax weights and a state-independent standard deviation."""

    def __init__(self, section: AwacSection, spec: AgentSpec, data: Transitions) -> None:
        s, a, hidden = spec.observation_size, spec.action_size, section.hidden
        self.section = section
        self.minibatches = Minibatches(data, section.batch_size)
        self.minibatches.standardise()
        self.actor, self.critics = mlp(s, hidden, a), TwinCritics(s + a, hidden)
        self.target_critics = deepcopy(self.critics)
        self.log_std_logits = nn.Parameter(torch.zeros(a))
        adam = torch.optim.Adam
        policy = [*self.actor.parameters(), self.log_std_logits]
        self.actor_adam = adam(policy, section.actor_learning_rate)
        self.critic_adam = adam(self.critics.parameters(), section.critic_learning_rate)

    def update(self) -> list[float]:
        s, a, r, next_s, done = self.minibatches.sample()

        with torch.no_grad():
            next_a = self.policy(next_s).sample().clamp(-1, 1)
            target = torch.min(*self.target_critics(next_s, next_a))
            target = r + self.section.discount * (1 - done) * target
        q1, q2 = self.critics(s, a)
        critic_loss = mse_loss(q1, target) + mse_loss(q2, target)

        policy = self.policy(s)
        with torch.no_grad():
            value = torch.min(*self.critics(s, policy.sample().clamp(-1, 1)))
            advantage = torch.min(*self.critics(s, a)) - value
            weight = len(s) * torch.softmax(advantage / self.section.temperature, 0)
        actor_loss = -(policy.log_prob(a).sum(-1) * weight).mean()
        step(self.critic_adam, critic_loss)
        step(self.actor_adam, actor_loss)

        follow(self.target_critics, self.critics, self.section.target_rate)
        return [critic_loss.item(), actor_loss.item()]

    def policy(self, s: Tensor) -> Normal:
        return Normal(self.actor(s).tanh(), (6 * self.log_std_logits.sigmoid() - 6).exp())
