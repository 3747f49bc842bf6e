"""Which policy a run recommends, which one tuning continues from, and when deployments end.

Functions of what the deployments measured and of nothing else: all agents get the team's reward, so
each decides alone, and all decide alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from otc_dist.run.measured_returns import Measured, best


@dataclass(frozen=True)
class Recommended:
    """A policy pi_k, and the deployment in which it acted; None: in none, so nobody measured it."""

    policy: int
    deployment: int | None


def recommended(
    keep: Literal["best", "last"], measured: Sequence[Measured | None], tuned: int
) -> Recommended:
    """What is recommended after the deployments 1 .. len(measured), when pi_tuned is the newest.

    Args:
        measured: of each deployment; with "best" none is None.
    """
    known = [one for one in measured if one is not None]
    if keep == "best" and known:
        deployment = best(known)
        return Recommended(deployment - 1, deployment)
    return Recommended(tuned, tuned + 1 if tuned < len(measured) else None)


def reverted(measured: Sequence[Measured]) -> int | None:
    """k of the policy pi_k from which tuning after deployment len(measured) goes on, if it is not
    the one that acted in it; None: it is.
    """
    policy = best(measured) - 1
    return policy if policy < len(measured) - 1 else None


def ends(floor: float | None, measured: Measured | None) -> bool:
    """Whether no deployment follows one that measured this."""
    return floor is not None and measured is not None and measured.mean < floor
