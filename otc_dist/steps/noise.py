"""Random arrays in bulk: what one update needs, sampled for a block of updates at once.

Sampling outside the step keeps it pure, costs less than sampling inside it, and lets every engine
see the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from otc_dist.system.lazy import torch

if TYPE_CHECKING:
    from torch import Tensor

Noise = Mapping[str, "Tensor"]  # random arrays by name, of one update or one action


class NoiseSpec(NamedTuple):
    """A random float32 array that one update needs: its distribution and its shape."""

    kind: Literal["normal", "exponential", "uniform"]  # standard ones; uniform in [0, 1)
    shape: tuple[int, ...]


def sample_noise(
    random: np.random.Generator, specs: Mapping[str, NoiseSpec], count: int
) -> dict[str, NDArray[np.float32]]:
    """Arrays as `specs` describe them for `count` updates, each (count, *shape)."""
    arrays = {}
    for name, (kind, shape) in specs.items():
        size = (count, *shape)
        if kind == "normal":
            arrays[name] = random.standard_normal(size, dtype=np.float32)
        elif kind == "exponential":
            arrays[name] = random.standard_exponential(size, dtype=np.float32)
        else:
            arrays[name] = random.random(size, dtype=np.float32)
    return arrays


def to_arrays(tensors: Mapping[str, Tensor]) -> dict[str, NDArray[np.generic]]:
    """The inverse of `to_tensors`; on the CPU the arrays share the tensors' memory."""
    return {name: tensor.cpu().numpy() for name, tensor in tensors.items()}


def to_tensors(
    arrays: Mapping[str, NDArray[np.generic]], device: torch.device
) -> dict[str, Tensor]:
    """The same arrays as tensors on `device`, without a copy on the CPU."""
    return {name: torch.from_numpy(array).to(device) for name, array in arrays.items()}
