"""Random batches, and arrays of the library as float64 tensors, for tests of the algorithms."""

import numpy as np
import torch

from otc_dist.algorithms.interface import Batch
from otc_dist.steps.state import State


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


def random_choices(random: np.random.Generator, s: int, choices: int, size: int) -> Batch:
    """Discrete actions; the masks in s and s' leave one or more of them available."""
    batch = random_batch(random, s, 1, size)
    for states in (batch.observation, batch.next_observation):
        mask = random.random((size, choices)) < 0.5
        mask[np.arange(size), random.integers(0, choices, size)] = True
        states[:, s - choices :] = torch.from_numpy(mask).to(states.dtype)
    likes = np.where(batch.observation[:, s - choices :] > 0, random.random((size, choices)), -1)
    actions = torch.from_numpy(likes.argmax(1)[:, None].astype(np.float64))
    return batch._replace(action=actions)


def double(arrays: dict[str, np.ndarray]) -> State:
    return {name: torch.from_numpy(np.array(array, np.float64)) for name, array in arrays.items()}


def first(arrays: dict[str, np.ndarray]) -> State:
    """What `sample_noise` gave for one update."""
    return {name: tensor[0] for name, tensor in double(arrays).items()}
