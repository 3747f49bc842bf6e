"""Networks as pure functions of one flat parameter vector, and Adam on such vectors.

One contiguous vector per optimizer: the whole optimizer step is then a handful of operations,
and a state dictionary holds a few tensors instead of a hundred.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from otc_dist.steps.stacking import is_mapped
from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

Tensors = tuple["Tensor", ...]
Layers = Sequence[tuple["Tensor", "Tensor"]]

ADAM_BETAS = (0.9, 0.999)
ADAM_EPSILON = 1e-8
LARGE = 2**20  # multiplications from which twin networks are faster one by one


@dataclass(frozen=True)
class Mlp:
    """A ReLU multi-layer perceptron on the concatenation of some inputs; `copies` side by side.

    Attributes:
        inputs: sizes of the inputs, which may have different leading shapes that broadcast:
            a state (B, 1, s) beside candidate actions (B, n, a) has its share of the first
            layer computed once, not n times.
        hidden: sizes of the hidden layers.
        outputs: size of the output.
        copies: number of independent networks, stacked (twin critics: 2).
    """

    inputs: tuple[int, ...]
    hidden: tuple[int, ...]
    outputs: int
    copies: int = 1

    @property
    def _layers(self) -> list[tuple[int, int]]:
        return list(pairwise((sum(self.inputs), *self.hidden, self.outputs)))

    @property
    def size(self) -> int:
        """Number of parameters, all copies together."""
        return self.copies * sum((fan_in + 1) * fan_out for fan_in, fan_out in self._layers)

    def initialise(self, random: np.random.Generator) -> np.ndarray:
        """Weights and biases uniform in +-1/sqrt(fan in) (torch.nn.Linear's default)."""
        parts = []
        for fan_in, fan_out in self._layers:
            count = self.copies * (fan_in + 1) * fan_out
            parts.append(random.uniform(-1.0, 1.0, count) / math.sqrt(fan_in))
        return np.concatenate(parts)

    def apply(self, parameters: Tensor, *inputs: Tensor) -> Tensor:
        """Outputs (..., outputs) of the one copy, or (copies, ..., outputs) of several.

        Args:
            parameters: flat vector (size,).
            inputs: one tensor (..., size) for each of `self.inputs`; leading shapes broadcast.
        """
        layers = self._split(parameters)
        leading = (value.shape[:-1] for value in inputs)
        rows = math.prod(torch.broadcast_shapes(*leading))  # type: ignore[no-untyped-call]
        # Not of more than two: what is compiled would grow with their number.
        if self.copies == 2 and rows * max(i * o for i, o in self._layers) >= LARGE:
            twins = [zip(torch.split(w, 1), torch.split(b, 1), strict=True) for w, b in layers]
            return torch.cat([self._forward(twin, inputs) for twin in zip(*twins, strict=True)])
        outputs = self._forward(layers, inputs)
        return outputs[0] if self.copies == 1 else outputs

    def _forward(self, layers: Layers, inputs: Tensors) -> Tensor:
        weight, bias = layers[0]
        shares = torch.split(weight, list(self.inputs), dim=1)
        products = [_times_first(x, share) for x, share in zip(inputs, shares, strict=True)]
        hidden = _add_bias(reduce(torch.add, products), bias)
        for weight, bias in layers[1:]:
            hidden = _add_bias(_times(torch.nn.functional.relu(hidden), weight), bias)
        return hidden

    def first(self) -> Mlp:
        """The shape of one copy alone; its parameters are `first_parameters`."""
        return Mlp(self.inputs, self.hidden, self.outputs)

    def first_parameters(self, parameters: Tensor) -> Tensor:
        """The flat parameters of copy 0, for `first()`."""
        return torch.cat([part[0].reshape(-1) for pair in self._split(parameters) for part in pair])

    def apart(self, parameters: Tensor) -> Tensor:
        """The flat parameters of each copy (copies, n), for `first()`."""
        parts = [part.reshape(self.copies, -1) for pair in self._split(parameters) for part in pair]
        return torch.cat(parts, dim=1)

    def _split(self, parameters: Tensor) -> Layers:
        """Views of each layer's weight (copies, fan_in, fan_out) and bias (copies, fan_out)."""
        sizes = [self.copies * size for i, o in self._layers for size in (i * o, o)]
        # One split: its gradient is one concatenation, that of slices a sum of padded vectors.
        parts = iter(torch.split(parameters, sizes))
        return [
            (next(parts).view(self.copies, i, o), next(parts).view(self.copies, o))
            for i, o in self._layers
        ]


def _times_first(value: Tensor, weight: Tensor) -> Tensor:
    """(..., i) times (copies, i, o): (copies, ..., o)."""
    rows = value.reshape(-1, value.shape[-1])
    return torch.matmul(rows, weight).view(len(weight), *value.shape[:-1], weight.shape[-1])


def _times(hidden: Tensor, weight: Tensor) -> Tensor:
    """(copies, ..., i) times (copies, i, o): (copies, ..., o)."""
    rows = hidden.reshape(len(weight), -1, weight.shape[1])
    if weight.shape[-1] == 1:  # a matrix product with one output column is slow
        product = (rows * weight.transpose(1, 2)).sum(-1, keepdim=True)
    else:
        product = torch.bmm(rows, weight)
    return product.view(*hidden.shape[:-1], weight.shape[-1])


def _add_bias(value: Tensor, bias: Tensor) -> Tensor:
    return value + bias.view(len(bias), *[1] * (value.ndim - 2), bias.shape[-1])


def value_and_gradient(
    loss: Callable[[Tensor], Tensor], parameters: Tensor
) -> tuple[Tensor, Tensor]:
    """The scalar `loss(parameters)` and its gradient (n,).

    Compiled code traces torch.func; eagerly its layers cost as much as the arithmetic, so there
    the same gradient comes from plain autograd, but of several states at once.
    """
    if torch.compiler.is_compiling() or is_mapped():
        gradient, value = torch.func.grad_and_value(loss)(parameters)
        return value, gradient
    with torch.enable_grad():
        leaf = parameters.detach().requires_grad_()
        value = loss(leaf)
        (gradient,) = torch.autograd.grad(value, leaf)
    return value.detach(), gradient


def adam(
    parameters: Tensor,
    gradient: Tensor,
    moments: Tensor,
    count: Tensor,
    learning_rate: float,
) -> tuple[Tensor, Tensor]:
    """One step of Adam (Kingma and Ba, 2015), as torch.optim.Adam computes it.

    Args:
        parameters: (n,) flat parameters.
        gradient: (n,).
        moments: (2, n) first and second moments.
        count: float64 scalar, this step's number (1 for the first). A tensor, since a Python
            number would be compiled in.

    Returns:
        New parameters and moments.
    """
    beta1, beta2 = ADAM_BETAS
    first = torch.lerp(moments[0], gradient, 1 - beta1)
    second = beta2 * moments[1] + (1 - beta2) * gradient * gradient
    # Stacked, compiled code has them in memory and does not compute powers for every parameter.
    corrections = torch.stack((learning_rate / (1 - beta1**count), torch.sqrt(1 - beta2**count)))
    size, root = corrections.to(parameters.dtype)
    parameters = parameters - size * first / (second.sqrt() / root + ADAM_EPSILON)
    return parameters, torch.stack((first, second))


def descend(
    state: Mapping[str, Tensor],
    name: str,
    learning_rate: float,
    *losses: Callable[[Tensor], Tensor],
) -> tuple[dict[str, Tensor], Tensor]:
    """One step of Adam on the network `name`: the new state, and the loss before the step.

    Args:
        state: as `fresh_state` makes it; its `updates` counts this step already.
        losses: scalars, of the network's parameters (n,), whose sum is the loss. Of several, one
            gradient is computed after the other: what each needs then fits the processor's cache.
    """
    value, gradient = value_and_gradient(losses[0], state[name])
    for loss in losses[1:]:
        another, part = value_and_gradient(loss, state[name])
        value, gradient = value + another, gradient + part
    moments = f"{name}_moments"
    parameters, new_moments = adam(
        state[name], gradient, state[moments], state["updates"], learning_rate
    )
    return {**state, name: parameters, moments: new_moments}, value


def when(condition: Tensor, change: Callable[[], Tensors], otherwise: Tensors) -> Tensors:
    """`change()` where the scalar `condition` holds, else the tensors `otherwise`, of like shapes.

    On the CPU a change that is not wanted is not computed. A GPU computes it and drops it: it
    would have to stop to read the condition, which a CUDA graph cannot. So it is where several
    states, of which each has its own condition, are updated at once.
    """
    on_cpu = condition.device.type == "cpu"
    if on_cpu and torch.compiler.is_compiling():
        chosen: Tensors = torch.cond(
            condition, change, lambda: tuple(tensor.clone() for tensor in otherwise)
        )
        return chosen
    if on_cpu and not is_mapped():
        return change() if condition else otherwise
    pairs = zip(change(), otherwise, strict=True)
    return tuple(torch.where(condition, new, old) for new, old in pairs)


def fresh_state(
    networks: Mapping[str, np.ndarray], targets: Iterable[str] = ()
) -> dict[str, np.ndarray]:
    """The state before the first update, float32.

    Keys: each network's name (n,), `_moments` (2, n) of its optimizer, and, for those named in
    `targets`, `_target`, equal to the network; `updates` (float64 scalar), the updates made.
    """
    state = {name: parameters.astype(np.float32) for name, parameters in networks.items()}
    for name, parameters in networks.items():
        state[f"{name}_moments"] = np.zeros((2, len(parameters)), dtype=np.float32)
    for name in targets:
        state[f"{name}_target"] = state[name].copy()
    return {**state, "updates": np.zeros((), dtype=np.float64)}


def polyak(target: Tensor, parameters: Tensor, rate: float) -> Tensor:
    """Target parameters moved by `rate` (tau) towards `parameters`."""
    return torch.lerp(target, parameters, rate)
