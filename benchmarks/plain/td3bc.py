"""Plain TD3+BC."""

from copy import deepcopy

import torch
from torch.nn.functional import mse_loss

from otc_dist.algorithms.td3bc import Td3BcSection
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

from .parts import Minibatches, TwinCritics, follow, mlp, step


class PlainTd3Bc:
    """TD3+BC after its authors' code: the data are normalised once, beforehand."""

    def __init__(self, section: Td3BcSection, spec: AgentSpec, data: Transitions) -> None:
        s, a, hidden = spec.observation_size, spec.action_size, section.hidden
        self.section, self.updates = section, 0
        self.minibatches = Minibatches(data, section.batch_size)
        self.minibatches.standardise()
        self.actor, self.critics = mlp(s, hidden, a), TwinCritics(s + a, hidden)
        self.target_actor, self.target_critics = deepcopy(self.actor), deepcopy(self.critics)
        adam = torch.optim.Adam
        self.actor_adam = adam(self.actor.parameters(), section.actor_learning_rate)
        self.critic_adam = adam(self.critics.parameters(), section.critic_learning_rate)

    def update(self) -> list[float]:
        s, a, r, next_s, done = self.minibatches.sample()
        self.updates += 1

        with torch.no_grad():
            noise = (0.2 * torch.randn_like(a)).clamp(-0.5, 0.5)
            next_a = (self.target_actor(next_s).tanh() + noise).clamp(-1, 1)
            target = torch.min(*self.target_critics(next_s, next_a))
            target = r + self.section.discount * (1 - done) * target
        q1, q2 = self.critics(s, a)
        critic_loss = mse_loss(q1, target) + mse_loss(q2, target)
        step(self.critic_adam, critic_loss)
        losses = [critic_loss.item()]

        if self.updates % 2 == 0:
            chosen = self.actor(s).tanh()
            q = self.critics.one(s, chosen)
            actor_loss = (
                mse_loss(chosen, a) - self.section.q_weight / q.abs().mean().detach() * q.mean()
            )
            step(self.actor_adam, actor_loss)
            follow(self.target_critics, self.critics, self.section.target_rate)
            follow(self.target_actor, self.actor, self.section.target_rate)
            losses.append(actor_loss.item())
        return losses
