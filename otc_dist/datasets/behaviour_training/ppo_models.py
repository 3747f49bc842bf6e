"""The networks that PPO trains: an actor for continuous or discrete actions, and a critic."""

import itertools
import math
from abc import abstractmethod

import torch
from torch import Tensor, nn

from otc_dist.datasets.behaviour import LAYERS
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Float32

Tensors = dict[str, Float32]  # as behaviour policies take them


def _network(sizes: tuple[int, ...], last_gain: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for index, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        last = index == len(sizes) - 2
        layer = nn.Linear(inputs, outputs)
        nn.init.orthogonal_(layer.weight, last_gain if last else math.sqrt(2))
        nn.init.zeros_(layer.bias)
        layers += [layer] if last else [layer, nn.Tanh()]
    return nn.Sequential(*layers)


class ActorCritic(nn.Module):
    """Two separate 64x64 tanh networks over the observation."""

    def __init__(self, observations: int, outputs: int) -> None:
        super().__init__()
        self.actor = _network((observations, 64, 64, outputs), 0.01)
        self.critic = _network((observations, 64, 64, 1), 1.0)

    @abstractmethod
    def sample(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (n, A), not clipped, and their log pi(a|s) (n,)."""

    @abstractmethod
    def evaluate(self, observations: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """log pi(a|s) of unclipped actions (n, A), (n,), and the mean entropy, a scalar."""

    def value(self, observations: Tensor) -> Tensor:
        """V(s), (n,)."""
        values: Tensor = self.critic(observations)
        return values.squeeze(-1)

    def snapshot(self) -> Tensors:
        """The actor's parameters."""
        tensors = {}
        linear = [layer for layer in self.actor if isinstance(layer, nn.Linear)]
        for name, layer in zip(LAYERS, linear, strict=True):
            tensors[f"{name}.weight"] = layer.weight.detach().numpy().copy()
            tensors[f"{name}.bias"] = layer.bias.detach().numpy().copy()
        return tensors


class Gaussian(ActorCritic):
    """Continuous actions: a normal distribution with a deviation that no state changes."""

    def __init__(self, observations: int, actions: int, initial_std: float) -> None:
        super().__init__(observations, actions)
        self.log_std = nn.Parameter(torch.full((actions,), math.log(initial_std)))

    def sample(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        mean = self.actor(observations)
        actions = mean + torch.exp(self.log_std) * torch.randn_like(mean)
        return actions, self.evaluate(observations, actions)[0]

    def evaluate(self, observations: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        means: Tensor = self.actor(observations)
        z = (actions - means) * torch.exp(-self.log_std)
        half = 0.5 * math.log(2 * math.pi)
        entropy = (self.log_std + half + 0.5).sum()
        return (-0.5 * z * z - self.log_std - half).sum(-1), entropy

    def snapshot(self) -> Tensors:
        return {"log_std": self.log_std.detach().numpy().copy(), **super().snapshot()}


class Masked(ActorCritic):
    """Discrete actions, of which the last entries of the observation say what is available."""

    def sample(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        actions = torch.multinomial(self._logs(observations).exp(), 1).float()
        return actions, self.evaluate(observations, actions)[0]

    def evaluate(self, observations: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        logs = self._logs(observations)
        entropy = -(logs.exp() * logs).sum(-1).mean()
        return logs.gather(1, actions.long()).squeeze(-1), entropy

    def _logs(self, observations: Tensor) -> Tensor:
        """log pi of every action (n, choices), next to -10^9 where it is not available."""
        logits: Tensor = self.actor(observations)
        available = observations[:, -logits.shape[1] :] > 0
        return logits.masked_fill(~available, -1e9).log_softmax(-1)


def actor_critic(agent: AgentSpec, initial_std: float) -> ActorCritic:
    """Fresh networks for such an agent; `initial_std` is of continuous actions."""
    if agent.choices:
        return Masked(agent.observation_size, agent.choices)
    return Gaussian(agent.observation_size, agent.action_size, initial_std)
