"""Discrete actions: from the vectors that agents send to the indices that a task takes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.transitions import Bool, Float32


def refused(agent: AgentSpec, actions: Float32, observations: Float32) -> int | None:
    """The first copy whose task would not take an agent's action; None: all take theirs.

    A task takes any continuous action, clipped; of discrete ones those that the observation names.

    Args:
        actions: (E, action_size), finite.
        observations: (E, observation_size), by which they were chosen.
    """
    if not agent.choices:
        return None
    wanted = actions[:, 0]
    inside = (wanted >= 0) & (wanted < agent.choices)
    index = np.where(inside, wanted, 0).astype(np.int64)
    available = observations[np.arange(len(index)), index - agent.choices] > 0
    (wrong,) = np.nonzero(~(inside & (index == wanted) & available))
    return int(wrong[0]) if len(wrong) else None


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
