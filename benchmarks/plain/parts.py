"""What plain single-file implementations have in common."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from otc_dist.transitions import Transitions


class Minibatches:
    """The data as one tensor a field, gathered one after another."""

    def __init__(self, data: Transitions, batch_size: int) -> None:
        arrays = (data.observations, data.actions, data.rewards, data.next_observations)
        self.fields = [torch.from_numpy(array) for array in arrays]
        self.fields.append(torch.from_numpy(data.terminated.astype(np.float32)))
        self.batch_size = batch_size

    def standardise(self) -> None:
        """The states, once, beforehand."""
        of = moments(self.fields[0])
        for field in (0, 3):
            self.fields[field] = normalised(self.fields[field], of)

    def sample(self) -> list[Tensor]:
        """s (B, s), a (B, a), r (B,), s' (B, s) and terminated (B,)."""
        rows = torch.randint(len(self.fields[0]), (self.batch_size,))
        return [field[rows] for field in self.fields]


class TwinCritics(nn.Module):
    """Two Q functions of (s, a)."""

    def __init__(self, inputs: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.first, self.second = mlp(inputs, hidden, 1), mlp(inputs, hidden, 1)

    def forward(self, s: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
        pair = torch.cat((s, a), -1)
        return self.first(pair).squeeze(-1), self.second(pair).squeeze(-1)

    def one(self, s: Tensor, a: Tensor) -> Tensor:
        value: Tensor = self.first(torch.cat((s, a), -1)).squeeze(-1)
        return value


def mlp(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise((inputs, *hidden, outputs)):
        layers += [nn.Linear(fan_in, fan_out), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def moments(values: Tensor) -> tuple[Tensor, Tensor]:
    return values.mean(0), values.std(0) + 1e-3


def normalised(values: Tensor, of: tuple[Tensor, Tensor]) -> Tensor:
    mean, std = of
    return (values - mean) / std


def step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()


def follow(target: nn.Module, source: nn.Module, rate: float) -> None:
    """Polyak averaging, parameter by parameter."""
    with torch.no_grad():
        for slow, parameter in zip(target.parameters(), source.parameters(), strict=True):
            slow.lerp_(parameter, rate)
