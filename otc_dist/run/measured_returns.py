"""What a deployment says of the policies that acted in it, and which of them was best.

A deployment has M transitions, in which few episodes end or many, depending on the policy: episodes
that were completed are biased towards short ones. So policies are compared by the return of the
first h steps of every episode that had room for h, with the same h at every deployment.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32, Float64

ENOUGH = 2  # episodes that an estimate and its standard error need
# What is set where deployments cannot be compared; a description may say revert of itself.
WITHOUT = "deployment.keep=last and deployment.revert=false"


class TooFewError(UserError):
    """A deployment holds too few episodes to measure the policies that acted in it."""


@dataclass(frozen=True)
class Measured:
    """The mean return of the first h steps of an episode, by the episodes of one deployment."""

    mean: float
    error: float  # standard error of the mean
    episodes: int


def horizon(steps: int, copies: int, max_episode_steps: int) -> int:
    """h, for deployments of `steps` lock-steps: all of them, or the longest episode if shorter.

    Long, since policies that outlast h are all alike: on Hopper those that return 2,001 and 2,532
    return 1,355 and 1,366 in 502 steps. The first episode of every copy then counts at least; of a
    single copy half of the steps are left for a second one.
    """
    return min(max_episode_steps, steps if copies >= ENOUGH else max(steps // 2, 1))


def certain(steps: int, copies: int, max_episode_steps: int) -> bool:
    """Whether deployments of `steps` lock-steps hold enough episodes whatever the policies do.

    The first episode of every copy counts. A second one of a single copy is certain only where
    none is so long that it leaves no room.
    """
    room = steps - horizon(steps, copies, max_episode_steps)
    return copies >= ENOUGH or max_episode_steps <= room


def possible(steps: int, copies: int) -> bool:
    """Whether deployments of `steps` lock-steps can hold enough episodes at all."""
    return copies >= ENOUGH or steps >= ENOUGH


def alike(rewards: Sequence[Float32]) -> bool:
    """Whether all agents got the same rewards, N arrays of any one shape."""
    return all(np.array_equal(rewards[0], other) for other in rewards[1:])


def team_rewards(rewards: Sequence[Float32]) -> Float32:
    """What the team got: every agent's reward where they are alike, to the bit; else their mean."""
    return rewards[0] if alike(rewards) else np.mean(rewards, axis=0, dtype=np.float32)


def measure(rewards: Float32, terminated: Bool, truncated: Bool, h: int) -> Measured:
    """Judge the policies that acted in one deployment.

    An episode that ended within h steps counts with all it returned; one that the simulator broke
    off within them does not count.

    Args:
        rewards: (T, E), one column an environment copy; the first row begins an episode.
        terminated, truncated: (T, E), an episode's last step; both: the simulator broke off there.
        h: steps that count.

    Raises:
        TooFewError: fewer than two episodes began at least h steps before the end.
    """
    steps = len(rewards)
    ends, broken = terminated | truncated, terminated & truncated
    begins = np.vstack((np.ones_like(ends[:1]), ends[:-1]))
    begins[max(steps - h + 1, 0) :] = False
    sums = np.vstack((np.zeros_like(rewards[:1], np.float64), rewards.cumsum(0, np.float64)))
    returns = []
    for start, copy in np.argwhere(begins):
        over = np.flatnonzero(ends[start : start + h, copy])
        stop = start + (over[0] + 1 if len(over) else h)
        if not broken[stop - 1, copy]:
            returns.append(sums[stop, copy] - sums[start, copy])
    if len(returns) < ENOUGH:
        raise TooFewError(
            f"to measure its policies a deployment must hold {ENOUGH} episodes that began {h} steps"
            f" before its end, and it holds {len(returns)}: deploy longer"
            f" (deployment.transitions, env.copies), or set {WITHOUT}"
        )
    return Measured(float(np.mean(returns)), float(standard_error(returns)), len(returns))


def standard_error(values: ArrayLike) -> Float64:
    """Of the means over the first axis of several values, (n, ...)."""
    array = np.asarray(values, np.float64)
    error: Float64 = array.std(axis=0, ddof=1) / math.sqrt(len(array))
    return error


def best(measured: Sequence[Measured]) -> int:
    """The number, from 1, of the deployment with the greatest mean; the first of equals."""
    return 1 + int(np.argmax([one.mean for one in measured]))
