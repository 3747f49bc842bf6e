"""Random batches, and arrays of the library as float64 tensors, for tests of the algorithms."""

import numpy as np
import torch

from otc_dist.algorithms.interface import Batch, State


def random_batch(random: np.random.Generator, s: int, a: int, size: int) -> Batch:
    states = random.standard_normal((2, size, s))
    fields = (
        states[0],
        random.uniform(-1, 1, (size, a)),
        random.standard_normal(size),
        states[0] + 0.1 * states[1],
        (random.random(size) < 0.1).astype(float),
    )
    return Batch(*(torch.from_numpy(field) for field in fields))


def double(arrays: dict[str, np.ndarray]) -> State:
    return {name: torch.from_numpy(np.array(array, np.float64)) for name, array in arrays.items()}


def first(arrays: dict[str, np.ndarray]) -> State:
    """What `draw` gave for one update."""
    return {name: tensor[0] for name, tensor in double(arrays).items()}
