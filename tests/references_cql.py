"""Plain CQL in float64, for continuous and for discrete actions: torch modules with autograd and
torch.optim.Adam, written from the published equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.distributions import Independent, Normal, TanhTransform, TransformedDistribution

from .references import Network, Standardised, follow, get_flat, set_flat, step


@dataclass
class Cql(Standardised):
    """CQL(H) of Kumar et al., 2020, with a fixed weight and no entropy in the backup."""

    s: int
    a: int
    hidden: Sequence[int]
    actor_rate: float
    critic_rate: float
    tau: float
    weight: float
    discount: float = 0.99

    def __post_init__(self) -> None:
        s, a, hidden = self.s, self.a, self.hidden
        self.actor = Network(s, hidden, 2 * a)
        self.critics = [Network(s + a, hidden, 1) for _ in range(2)]
        self.target_critics = [Network(s + a, hidden, 1) for _ in range(2)]
        self.log_temperature = torch.zeros(1, dtype=torch.float64, requires_grad=True)
        adam = torch.optim.Adam
        self.actor_adam = adam(self.actor.parameters(), lr=self.actor_rate)
        self.temperature_adam = adam([self.log_temperature], lr=self.actor_rate)
        self.critic_adams = [adam(c.parameters(), lr=self.critic_rate) for c in self.critics]

    def load(self, state: Mapping[str, Tensor]) -> None:
        set_flat([self.actor], state["actor"])
        set_flat(self.critics, state["critic"], twins=True)
        set_flat(self.target_critics, state["critic_target"], twins=True)
        with torch.no_grad():
            self.log_temperature.copy_(state["log_temperature"])

    def weights(self) -> dict[str, Tensor]:
        return {
            "actor": get_flat([self.actor]),
            "critic": get_flat(self.critics, twins=True),
            "critic_target": get_flat(self.target_critics, twins=True),
            "log_temperature": self.log_temperature.detach(),
        }

    def sample(self, s: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Actions for noise (..., a) and their log probabilities, by torch.distributions."""
        mean, log_std = self.actor(s).chunk(2, -1)
        std = torch.exp(log_std.clamp(-5, 2))
        squash = TanhTransform(cache_size=1)  # keeps u, instead of inverting tanh
        distribution = TransformedDistribution(Independent(Normal(mean, std), 1), squash)
        actions = squash(mean + std * noise)
        return actions, distribution.log_prob(actions)

    def sample_several(self, s: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """As `sample`, for states (B, s) and noise (B, n, a)."""
        return self.sample(s[:, None].expand(-1, noise.shape[1], -1), noise)

    def value(self, s: Tensor, noise: Tensor) -> Tensor:
        repeated = self.standard(s)[:, None].expand(-1, noise.shape[1], -1)
        return self.critics[0](repeated, self.sample(repeated, noise)[0])[..., 0].mean(1)

    def act(self, s: Tensor) -> Tensor:
        return torch.tanh(self.actor(self.standard(s))[:, : self.a])

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """One update; the critics' and the actor's loss, the temperature and the mean target."""
        s, a, r, next_s, done = batch
        s, next_s = self.standard(s), self.standard(next_s)
        new_a, log_pi = self.sample(s, noise["actor"])
        temperature_loss = -(self.log_temperature * (log_pi - self.a).detach()).mean()
        step(self.temperature_adam, temperature_loss)
        temperature = self.log_temperature.exp().detach()
        q = torch.min(*(critic(s, new_a)[:, 0] for critic in self.critics))
        actor_loss = (temperature * log_pi - q).mean()

        with torch.no_grad():
            next_a, _ = self.sample(next_s, noise["target"])
            next_q = torch.min(*(critic(next_s, next_a)[:, 0] for critic in self.target_critics))
            y = r + (1 - done) * self.discount * next_q
            uniform = -1 + 2 * noise["random"]
            current, current_log_pi = self.sample_several(s, noise["current"])
            following, next_log_pi = self.sample_several(next_s, noise["next"])
        critic_losses = []
        for critic in self.critics:

            def judge(actions: Tensor, critic: Network = critic) -> Tensor:
                repeated = s[:, None].expand(-1, actions.shape[1], -1)
                return critic(repeated, actions)[..., 0]

            corrected = [
                judge(uniform) - np.log(0.5**self.a),
                judge(current) - current_log_pi,
                judge(following) - next_log_pi,
            ]
            q_data = critic(s, a)[:, 0]
            out_of_data = torch.logsumexp(torch.cat(corrected, 1), 1)
            gap = (out_of_data - q_data).mean()
            critic_losses.append(((q_data - y) ** 2).mean() + self.weight * gap)

        step(self.actor_adam, actor_loss)
        for optimizer, loss in zip(self.critic_adams, critic_losses, strict=True):
            step(optimizer, loss)
        follow(self.critics, self.target_critics, self.tau)
        critic_loss = sum(loss.item() for loss in critic_losses)
        return [critic_loss, actor_loss.item(), temperature.item(), y.mean().item()]


@dataclass
class DiscreteCql:
    """Double DQN with the conservative term; state by state, over lists of available actions."""

    s: int
    choices: int
    hidden: Sequence[int]
    rate: float
    tau: float
    weight: float
    discount: float = 0.99

    def __post_init__(self) -> None:
        self.critic = Network(self.s, self.hidden, self.choices)
        self.target_critic = Network(self.s, self.hidden, self.choices)
        self.adam = torch.optim.Adam(self.critic.parameters(), lr=self.rate)

    def load(self, state: Mapping[str, Tensor]) -> None:
        set_flat([self.critic], state["critic"])
        set_flat([self.target_critic], state["critic_target"])

    def weights(self) -> dict[str, Tensor]:
        return {
            "critic": get_flat([self.critic]),
            "critic_target": get_flat([self.target_critic]),
        }

    def available(self, s: Tensor) -> list[int]:
        mask = s[len(s) - self.choices :].tolist()
        return [index for index, entry in enumerate(mask) if entry > 0]

    def best(self, s: Tensor) -> list[int]:
        """The index of the best available action of each state, one state at a time."""
        return [
            max(self.available(state), key=lambda index, values=q: float(values[index]))
            for state, q in zip(s, self.critic(s), strict=True)
        ]

    def value(self, s: Tensor) -> Tensor:
        q = self.critic(s)
        return torch.stack([q[row, index] for row, index in enumerate(self.best(s))])

    def act(self, s: Tensor) -> Tensor:
        return torch.tensor([[float(index)] for index in self.best(s)], dtype=torch.float64)

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        s, a, r, next_s, done = batch
        with torch.no_grad():
            next_q, best = self.target_critic(next_s), self.best(next_s)
        losses, targets = [], []
        for row, q in enumerate(self.critic(s)):
            index = int(a[row])
            y = r[row] if done[row] else r[row] + self.discount * next_q[row, best[row]]
            error = (q[index] - y).abs()
            huber = 0.5 * error**2 if error <= 1 else error - 0.5
            gap = torch.log(torch.exp(q[self.available(s[row])]).sum()) - q[index]
            losses.append(huber + self.weight * gap)
            targets.append(y)
        loss = torch.stack(losses).mean()
        step(self.adam, loss)
        follow([self.critic], [self.target_critic], self.tau)
        return [loss.item(), torch.stack(targets).mean().item()]
