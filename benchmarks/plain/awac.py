"""Plain AWAC."""

from collections.abc import Mapping, Sequence
from copy import deepcopy

import torch
from torch import Tensor, nn
from torch.distributions import Normal
from torch.nn.functional import mse_loss

from otc_dist.algorithms.awac import AwacSection

from .parts import TwinCritics, follow, mlp, several, step


class PlainAwac:
    """AWAC of Nair et al., 2020, as the authors' code has it, or with CORL's weights; its standard
    deviation does not depend on the state.
    """

    standardised = True

    def __init__(
        self, section: AwacSection, s: int, a: int, dtype: torch.dtype = torch.float32
    ) -> None:
        hidden = section.hidden
        self.section, self.action_size = section, a
        self.actor, self.critics = mlp(s, hidden, a, dtype), TwinCritics(s + a, hidden, dtype)
        self.target_critics = deepcopy(self.critics)
        self.log_std_logits = nn.Parameter(torch.zeros(a, dtype=dtype))
        adam = torch.optim.Adam
        policy = [*self.actor.parameters(), self.log_std_logits]
        self.actor_adam = adam(policy, section.actor_learning_rate)
        self.critic_adam = adam(self.critics.parameters(), section.critic_learning_rate)

    def sample_noise(self, count: int) -> dict[str, Tensor]:
        return {name: torch.randn(count, self.action_size) for name in ("target", "actor")}

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """The losses of the critics and of the actor, and the mean target."""
        s, a, r, next_s, done = batch

        with torch.no_grad():
            next_a = self.sample(self.policy(next_s), noise["target"])
            target = torch.min(*self.target_critics(next_s, next_a))
            target = r + self.section.discount * (1 - done) * target
        q1, q2 = self.critics(s, a)
        critic_loss = mse_loss(q1, target) + mse_loss(q2, target)

        policy = self.policy(s)
        with torch.no_grad():
            value = torch.min(*self.critics(s, self.sample(policy, noise["actor"])))
            weight = self.weights(torch.min(*self.critics(s, a)) - value)
        actor_loss = -(policy.log_prob(a).sum(-1) * weight).mean()
        step(self.critic_adam, critic_loss)
        step(self.actor_adam, actor_loss)

        follow(self.target_critics, self.critics, self.section.target_rate)
        return [x.item() for x in (critic_loss, actor_loss, target.mean())]

    def weights(self, advantages: Tensor) -> Tensor:
        scores = advantages / self.section.temperature
        if self.section.weighting == "softmax":
            return len(scores) * torch.softmax(scores, 0)
        return scores.exp().clamp(max=100)

    def policy(self, s: Tensor) -> Normal:
        return Normal(self.actor(s).tanh(), (6 * self.log_std_logits.sigmoid() - 6).exp())

    def sample(self, policy: Normal, noise: Tensor) -> Tensor:
        return (policy.mean + policy.stddev * noise).clamp(-1, 1)

    def value(self, s: Tensor, noise: Tensor) -> Tensor:
        """The mean of Q_1 over actions of the policy (B,), for noise (B, n, a)."""
        repeated = several(s, noise.shape[1])
        return self.critics.one(repeated, self.sample(self.policy(repeated), noise)).mean(1)

    def act(self, s: Tensor) -> Tensor:
        return self.policy(s).mean
