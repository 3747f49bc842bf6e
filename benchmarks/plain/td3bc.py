"""Plain TD3+BC."""

from collections.abc import Mapping, Sequence
from copy import deepcopy

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from otc_dist.algorithms.td3bc import Td3BcSection

from .parts import TwinCritics, follow, mlp, step


class PlainTd3Bc:
    """TD3+BC of Fujimoto and Gu, 2021, for actions in [-1, 1]."""

    standardised = True

    def __init__(
        self, section: Td3BcSection, s: int, a: int, dtype: torch.dtype = torch.float32
    ) -> None:
        hidden = section.hidden
        self.section, self.action_size, self.updates = section, a, 0
        self.actor, self.critics = mlp(s, hidden, a, dtype), TwinCritics(s + a, hidden, dtype)
        self.target_actor, self.target_critics = deepcopy(self.actor), deepcopy(self.critics)
        adam = torch.optim.Adam
        self.actor_adam = adam(self.actor.parameters(), section.actor_learning_rate)
        self.critic_adam = adam(self.critics.parameters(), section.critic_learning_rate)

    def sample_noise(self, count: int) -> dict[str, Tensor]:
        return {"target": torch.randn(count, self.action_size)}

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """The losses of the critics and of the actor (0 where it waits; otherwise twice, once for
        the update it waited), and the mean target.
        """
        s, a, r, next_s, done = batch
        self.updates += 1

        with torch.no_grad():
            smoothing = (0.2 * noise["target"]).clamp(-0.5, 0.5)
            next_a = (self.target_actor(next_s).tanh() + smoothing).clamp(-1, 1)
            target = torch.min(*self.target_critics(next_s, next_a))
            target = r + self.section.discount * (1 - done) * target
        q1, q2 = self.critics(s, a)
        critic_loss = mse_loss(q1, target) + mse_loss(q2, target)
        step(self.critic_adam, critic_loss)

        actor_metric = 0.0
        if self.updates % 2 == 0:
            chosen = self.act(s)
            q = self.critics.one(s, chosen)
            actor_loss = (
                mse_loss(chosen, a) - self.section.q_weight / q.abs().mean().detach() * q.mean()
            )
            step(self.actor_adam, actor_loss)
            follow(self.target_critics, self.critics, self.section.target_rate)
            follow(self.target_actor, self.actor, self.section.target_rate)
            actor_metric = 2 * actor_loss.item()
        return [critic_loss.item(), actor_metric, target.mean().item()]

    def act(self, s: Tensor) -> Tensor:
        chosen: Tensor = self.actor(s).tanh()
        return chosen

    def value(self, s: Tensor) -> Tensor:
        return self.critics.one(s, self.act(s))
