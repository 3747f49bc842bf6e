"""Plain CQL for discrete actions."""

from collections.abc import Mapping, Sequence
from copy import deepcopy

import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from otc_dist.algorithms.discrete_cql import DiscreteCqlSection

from .parts import follow, mlp, step


class PlainDiscreteCql:
    """Double deep Q-learning with a conservative term. The last entries of a state tell which
    actions are available; the others are masked.
    """

    standardised = False

    def __init__(
        self, section: DiscreteCqlSection, s: int, actions: int, dtype: torch.dtype = torch.float32
    ) -> None:
        self.section, self.actions = section, actions
        self.critic = mlp(s, section.hidden, actions, dtype)
        self.target_critic = deepcopy(self.critic)
        parameters = self.critic.parameters()
        self.critic_adam = torch.optim.Adam(parameters, section.critic_learning_rate)

    def sample_noise(self, count: int) -> dict[str, Tensor]:
        return {}

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """The loss and the mean target."""
        s, a, r, next_s, done = batch

        with torch.no_grad():
            greedy = self.act(next_s)
            target = self.target_critic(next_s).gather(1, greedy).squeeze(1)
            target = r + self.section.discount * (1 - done) * target
        values = self.critic(s)
        q = values.gather(1, a.long()).squeeze(1)
        gap = (torch.logsumexp(self.masked(values, s), 1) - q).mean()
        loss = smooth_l1_loss(q, target) + self.section.weight * gap
        step(self.critic_adam, loss)

        follow(self.target_critic, self.critic, self.section.target_rate)
        return [loss.item(), target.mean().item()]

    def masked(self, values: Tensor, s: Tensor) -> Tensor:
        """Values of actions (B, n), -inf where unavailable."""
        return values.masked_fill(s[:, -self.actions :] <= 0, -torch.inf)

    def value(self, s: Tensor) -> Tensor:
        return self.masked(self.critic(s), s).amax(1)

    def act(self, s: Tensor) -> Tensor:
        """Indices of actions (B, 1)."""
        return self.masked(self.critic(s), s).argmax(1, keepdim=True)
