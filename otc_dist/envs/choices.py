"""Discrete actions: from the vectors that agents send to the indices that a task takes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otc_dist.spec import TeamSpec
from otc_dist.transitions import Bool, Float32


def chosen(spec: TeamSpec, actions: Sequence[Float32], available: Bool) -> NDArray[np.int64]:
    """Indices (E, N) of the discrete actions N x (E, 1).

    Args:
        available: which actions each agent has, (E, N, choices).

    Raises:
        ValueError: an array of the wrong shape, no index, or an action that is not available.
    """
    copies = len(available)
    if len(actions) != len(spec.agents):
        raise ValueError(f"{len(actions)} actions for {len(spec.agents)} agents")
    for name, action in zip(spec.names, actions, strict=True):
        if action.shape != (copies, 1):
            raise ValueError(f"the action of {name} has shape {action.shape}, not {(copies, 1)}")
    wanted = np.concatenate(actions, axis=1)
    choices = available.shape[2]
    inside = (wanted >= 0) & (wanted < choices)  # not so where it is not a number
    index = np.where(inside, wanted, 0).astype(np.int64)
    right = inside & (index == wanted)
    right &= np.take_along_axis(available, index[:, :, None], axis=2)[:, :, 0]
    if not right.all():
        copy, agent = np.argwhere(~right)[0]
        offered = np.flatnonzero(available[copy, agent]).tolist()
        raise ValueError(
            f"{spec.names[agent]} cannot take action {wanted[copy, agent]:g} in copy {copy}:"
            f" available are {offered}"
        )
    return index
