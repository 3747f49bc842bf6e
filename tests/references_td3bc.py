"""Plain TD3+BC in float64: torch modules with autograd and torch.optim.Adam, written from the
published equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .references import Network, Standardised, follow, get_flat, set_flat, step


@dataclass
class Td3Bc(Standardised):
    """TD3+BC of Fujimoto and Gu, 2021, for actions in [-1, 1]."""

    s: int
    a: int
    hidden: Sequence[int]
    actor_rate: float
    critic_rate: float
    tau: float
    alpha: float = 2.5
    discount: float = 0.99

    def __post_init__(self) -> None:
        s, a, hidden = self.s, self.a, self.hidden
        self.actor, self.target_actor = Network(s, hidden, a), Network(s, hidden, a)
        self.critics = [Network(s + a, hidden, 1) for _ in range(2)]
        self.target_critics = [Network(s + a, hidden, 1) for _ in range(2)]
        adam = torch.optim.Adam
        self.actor_adam = adam(self.actor.parameters(), lr=self.actor_rate)
        twins = [p for critic in self.critics for p in critic.parameters()]
        self.critic_adam = adam(twins, lr=self.critic_rate)
        self.updates = 0

    def load(self, state: Mapping[str, Tensor]) -> None:
        set_flat([self.actor], state["actor"])
        set_flat([self.target_actor], state["actor_target"])
        set_flat(self.critics, state["critic"], twins=True)
        set_flat(self.target_critics, state["critic_target"], twins=True)

    def weights(self) -> dict[str, Tensor]:
        return {
            "actor": get_flat([self.actor]),
            "actor_target": get_flat([self.target_actor]),
            "critic": get_flat(self.critics, twins=True),
            "critic_target": get_flat(self.target_critics, twins=True),
        }

    def act(self, s: Tensor) -> Tensor:
        return torch.tanh(self.actor(self.standard(s)))

    def value(self, s: Tensor) -> Tensor:
        return self.critics[0](self.standard(s), self.act(s))[:, 0]

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """One update; the losses of the critics and of the actor (0 where it waits; otherwise
        twice, once for the update it waited), and the mean target.
        """
        s, a, r, next_s, done = batch
        s, next_s = (self.standard(x) for x in (s, next_s))
        self.updates += 1
        with torch.no_grad():
            smoothing = (0.2 * noise["target"]).clamp(-0.5, 0.5)
            next_a = (torch.tanh(self.target_actor(next_s)) + smoothing).clamp(-1, 1)
            next_q = torch.min(*(critic(next_s, next_a)[:, 0] for critic in self.target_critics))
            y = r + (1 - done) * self.discount * next_q
        critic_loss = sum(((critic(s, a)[:, 0] - y) ** 2).mean() for critic in self.critics)
        step(self.critic_adam, critic_loss)

        actor_metric = 0.0
        if self.updates % 2 == 0:
            pi = torch.tanh(self.actor(s))
            q = self.critics[0](s, pi)
            actor_loss = -self.alpha / q.abs().mean().item() * q.mean() + ((pi - a) ** 2).mean()
            step(self.actor_adam, actor_loss)
            networks = [*self.critics, self.actor]
            follow(networks, [*self.target_critics, self.target_actor], self.tau)
            actor_metric = 2 * actor_loss.item()
        return [critic_loss.item(), actor_metric, y.mean().item()]
