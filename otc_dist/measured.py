"""What a deployment says of the policies that acted in it, and which of them was best.

A deployment has M transitions, in which few episodes end or many, depending on the policy: episodes
that were completed are biased towards short ones. So policies are compared by the return of the
first h steps of every episode that had room for h, with the same h at every deployment.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otc_dist.errors import UserError
from otc_dist.transitions import Bool, Float32

ENOUGH = 2  # episodes that an estimate and its standard error need


@dataclass(frozen=True)
class Measured:
    """The mean return of the first h steps of an episode, by the episodes of one deployment."""

    mean: float
    error: float  # standard error of the mean
    episodes: int


def horizon(steps: int, max_episode_steps: int) -> int:
    """h, for deployments of `steps` lock-steps: half of them, or the longest episode if shorter.

    Half, so that in a task whose episodes end early more than the first of every copy count.
    """
    return min(max_episode_steps, max(steps // 2, 1))


def measure(rewards: Float32, ends: Bool, h: int) -> Measured:
    """Judge the policies that acted in one deployment.

    Args:
        rewards: (T, E), one column an environment copy; the first row begins an episode.
        ends: (T, E), whether the step was an episode's last.
        h: steps that count; an episode that ended earlier counts with all it returned.

    Raises:
        UserError: fewer than two episodes began at least h steps before the end.
    """
    steps = len(rewards)
    begins = np.vstack((np.ones_like(ends[:1]), ends[:-1]))
    begins[max(steps - h + 1, 0) :] = False
    sums = np.vstack((np.zeros_like(rewards[:1], np.float64), rewards.cumsum(0, np.float64)))
    returns = []
    for start, copy in np.argwhere(begins):
        over = np.flatnonzero(ends[start : start + h, copy])
        stop = start + (over[0] + 1 if len(over) else h)
        returns.append(sums[stop, copy] - sums[start, copy])
    if len(returns) < ENOUGH:
        raise UserError(
            f"deployment.keep = 'best' needs {ENOUGH} episodes of a deployment that began {h} steps"
            f" before its end, and there are {len(returns)}: deploy longer"
            " (deployment.transitions), or use deployment.keep = 'last'"
        )
    error = float(np.std(returns, ddof=1)) / math.sqrt(len(returns))
    return Measured(float(np.mean(returns)), error, len(returns))


def best(measured: Sequence[Measured]) -> int:
    """The number, from 1, of the deployment with the greatest mean; the first of equals."""
    return 1 + int(np.argmax([one.mean for one in measured]))
