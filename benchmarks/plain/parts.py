"""What plain single-file implementations have in common."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from otc_dist.transitions import Transitions

Statistics = tuple[Tensor, Tensor]  # mean and standard deviation (n,)


class Plain(Protocol):
    """One algorithm, in the dtype that it was made with."""

    standardised: bool  # whether it is to be given standardised states

    def sample_noise(self, count: int) -> dict[str, Tensor]:
        """What an update of `count` transitions needs of chance, in float32."""
        ...

    def update(self, batch: Sequence[Tensor], noise: Mapping[str, Tensor]) -> list[float]:
        """One update by s (B, s), a (B, a), r (B,), s' (B, s) and terminated (B,); its metrics, in
        the order of ours.
        """
        ...


class Training:
    """Updates of a plain algorithm, each by a minibatch and noise that it draws itself."""

    def __init__(self, algorithm: Plain, data: Transitions, batch_size: int) -> None:
        self.algorithm, self.batch_size = algorithm, batch_size
        arrays = (data.observations, data.actions, data.rewards, data.next_observations)
        self.fields = [torch.from_numpy(array) for array in arrays]
        self.fields.append(torch.from_numpy(data.terminated.astype(np.float32)))
        if algorithm.standardised:
            of = statistics(self.fields[0])
            for states in (0, 3):
                self.fields[states] = normalised(self.fields[states], of)

    def sample(self) -> list[Tensor]:
        """A minibatch, gathered field by field."""
        rows = torch.randint(len(self.fields[0]), (self.batch_size,))
        return [field[rows] for field in self.fields]

    def update(self) -> list[float]:
        return self.algorithm.update(self.sample(), self.algorithm.sample_noise(self.batch_size))


class TwinCritics(nn.Module):
    """Two Q functions of (s, a)."""

    def __init__(self, inputs: int, hidden: Sequence[int], dtype: torch.dtype) -> None:
        super().__init__()
        self.first, self.second = (mlp(inputs, hidden, 1, dtype) for _ in range(2))

    def forward(self, s: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
        pair = torch.cat((s, a), -1)
        return self.first(pair).squeeze(-1), self.second(pair).squeeze(-1)

    def one(self, s: Tensor, a: Tensor) -> Tensor:
        value: Tensor = self.first(torch.cat((s, a), -1)).squeeze(-1)
        return value


def mlp(inputs: int, hidden: Sequence[int], outputs: int, dtype: torch.dtype) -> nn.Sequential:
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise((inputs, *hidden, outputs)):
        layers += [nn.Linear(fan_in, fan_out, dtype=dtype), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def statistics(values: Tensor) -> Statistics:
    """Of each column of values (N, n)."""
    return values.mean(0), values.std(0, correction=0) + 1e-3


def normalised(values: Tensor, of: Statistics) -> Tensor:
    mean, std = of
    return (values - mean) / std


def several(s: Tensor, count: int) -> Tensor:
    """States (B, s) as (B, count, s)."""
    return s.unsqueeze(1).repeat(1, count, 1)


def step(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()


def follow(target: nn.Module, source: nn.Module, rate: float) -> None:
    """Polyak averaging, parameter by parameter."""
    with torch.no_grad():
        for slow, parameter in zip(target.parameters(), source.parameters(), strict=True):
            slow.lerp_(parameter, rate)
