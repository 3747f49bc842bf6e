"""Plain CQL for discrete actions."""

from copy import deepcopy

import torch
from torch.nn.functional import smooth_l1_loss

from otc_dist.algorithms.discrete_cql import DiscreteCqlSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

from .parts import Minibatches, follow, mlp, step


class PlainDiscreteCql:
    """Double deep Q-learning with a conservative term; unavailable actions are masked."""

    def __init__(self, section: DiscreteCqlSection, spec: AgentSpec, data: Transitions) -> None:
        self.section, self.choices = section, spec.choices
        self.minibatches = Minibatches(data, section.batch_size)
        self.critic = mlp(spec.observation_size, section.hidden, spec.choices)
        self.target_critic = deepcopy(self.critic)
        parameters = self.critic.parameters()
        self.critic_adam = torch.optim.Adam(parameters, section.critic_learning_rate)

    def update(self) -> list[float]:
        s, a, r, next_s, done = self.minibatches.sample()
        available, next_available = s[:, -self.choices :] > 0, next_s[:, -self.choices :] > 0

        with torch.no_grad():
            greedy = self.critic(next_s).masked_fill(~next_available, -torch.inf).argmax(1)
            target = self.target_critic(next_s).gather(1, greedy.unsqueeze(1)).squeeze(1)
            target = r + self.section.discount * (1 - done) * target
        values = self.critic(s)
        q = values.gather(1, a.long()).squeeze(1)
        spread = torch.logsumexp(values.masked_fill(~available, -torch.inf), 1)
        loss = smooth_l1_loss(q, target) + self.section.weight * (spread - q).mean()
        step(self.critic_adam, loss)

        follow(self.target_critic, self.critic, self.section.target_rate)
        return [loss.item()]
