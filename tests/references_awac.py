"""Plain AWAC in float64: torch modules with autograd and torch.optim.Adam, written from the
published equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.distributions import Independent, Normal

from .references import Network, Standardised, follow, get_flat, set_flat, step


@dataclass
class Awac(Standardised):
    """AWAC of Nair et al., 2020, as the authors' code has it, and with CORL's weights."""

    s: int
    a: int
    hidden: Sequence[int]
    actor_rate: float
    critic_rate: float
    tau: float
    weighting: str
    temperature: float
    discount: float = 0.99

    def __post_init__(self) -> None:
        s, a, hidden = self.s, self.a, self.hidden
        self.actor = Network(s, hidden, a)
        self.logits = torch.zeros(a, dtype=torch.float64, requires_grad=True)
        self.critics = [Network(s + a, hidden, 1) for _ in range(2)]
        self.target_critics = [Network(s + a, hidden, 1) for _ in range(2)]
        adam = torch.optim.Adam
        self.actor_adam = adam([*self.actor.parameters(), self.logits], lr=self.actor_rate)
        self.critic_adams = [adam(c.parameters(), lr=self.critic_rate) for c in self.critics]

    def load(self, state: Mapping[str, Tensor]) -> None:
        set_flat([self.actor], state["actor"][: -self.a])
        with torch.no_grad():
            self.logits.copy_(state["actor"][-self.a :])
        set_flat(self.critics, state["critic"], twins=True)
        set_flat(self.target_critics, state["critic_target"], twins=True)

    def weights(self) -> dict[str, Tensor]:
        return {
            "actor": torch.cat([get_flat([self.actor]), self.logits.detach()]),
            "critic": get_flat(self.critics, twins=True),
            "critic_target": get_flat(self.target_critics, twins=True),
        }

    def policy(self, s: Tensor) -> Independent:
        mean = torch.tanh(self.actor(s))
        return Independent(Normal(mean, torch.exp(-6 + 6 * torch.sigmoid(self.logits))), 1)

    def sample(self, s: Tensor, noise: Tensor) -> Tensor:
        policy = self.policy(s)
        return (policy.mean + policy.stddev * noise).clamp(-1, 1)

    def value(self, s: Tensor, noise: Tensor) -> Tensor:
        repeated = self.standard(s)[:, None].expand(-1, noise.shape[1], -1)
        return self.critics[0](repeated, self.sample(repeated, noise))[..., 0].mean(1)

    def act(self, s: Tensor) -> Tensor:
        return self.policy(self.standard(s)).mean

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """One update; the losses of the critics and of the actor, and the mean target."""
        s, a, r, next_s, done = batch
        s, next_s = self.standard(s), self.standard(next_s)
        with torch.no_grad():
            next_a = self.sample(next_s, noise["target"])
            next_q = torch.min(*(critic(next_s, next_a)[:, 0] for critic in self.target_critics))
            y = r + (1 - done) * self.discount * next_q
        q = [critic(s, a)[:, 0] for critic in self.critics]
        critic_losses = [((q_j - y) ** 2).mean() for q_j in q]

        with torch.no_grad():
            new_a = self.sample(s, noise["actor"])
            v = torch.min(*(critic(s, new_a)[:, 0] for critic in self.critics))
            scores = (torch.min(*q) - v) / self.temperature
            if self.weighting == "softmax":
                weights = len(s) * torch.exp(scores) / torch.exp(scores).sum()
            else:
                weights = torch.exp(scores).clamp(max=100)
        actor_loss = -(weights * self.policy(s).log_prob(a)).mean()

        for optimizer, loss in zip(self.critic_adams, critic_losses, strict=True):
            step(optimizer, loss)
        step(self.actor_adam, actor_loss)
        follow(self.critics, self.target_critics, self.tau)
        return [sum(loss.item() for loss in critic_losses), actor_loss.item(), y.mean().item()]
