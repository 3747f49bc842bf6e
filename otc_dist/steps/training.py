"""The training loop: blocks of updates with their random numbers sampled in bulk."""

from collections.abc import Callable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray

from otc_dist.steps.engine import Update
from otc_dist.steps.noise import to_tensors
from otc_dist.steps.state import State

BLOCK = 100  # updates whose random numbers share one key, where an update takes milliseconds

SampleBlock = Callable[[int, int], Mapping[str, NDArray[np.generic]]]
OnBlock = Callable[[State, int, list[float]], None]


def train(
    state: State,
    update: Update,
    sample_block: SampleBlock,
    device: torch.device,
    span: tuple[int, int],
    block: int,
    on_block: OnBlock,
) -> State:
    """Updates [start, stop) of `span`; start is a multiple of `block`.

    Args:
        block: updates whose random numbers share one key.
        sample_block: the random arrays (count, ...) of block b, from (b, count). A function of the
            block's number alone, so that training goes on after an interruption as if none
            had been.
        on_block: called after each block with the state, updates done, and the block's mean
            metrics.

    Returns:
        The state after the last update.
    """
    for first in range(span[0], span[1], block):
        count = min(block, span[1] - first)
        sampled = to_tensors(sample_block(first // block, count), device)
        arrays = zip(*(array.unbind() for array in sampled.values()), strict=True)
        numbers = (dict(zip(sampled, each, strict=True)) for each in arrays)
        state, total = update(state, next(numbers))
        total = total.clone()
        for each in numbers:
            state, metrics = update(state, each)
            total += metrics
        on_block(state, first + count, (total / count).tolist())
    return state
