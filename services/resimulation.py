"""Bringing a simulator to where an unfinished log ends, by playing the log again."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from otc_dist.deployment_log.reader import read_steps
from otc_dist.envs.rollout import Rollout
from otc_dist.transitions import JointStep

from .process import FailureError


def resimulate(rollout: Rollout, path: Path, steps: int) -> JointStep | None:
    """Advance a fresh `rollout` by the first `steps` logged steps; returns the last of them.

    Raises:
        FailureError: a step does not come out as it was logged, to the bit.
    """
    last = None
    for logged in read_steps(path, 0, steps):
        last = rollout.advance(logged.actions, logged.exploring)
        wrong = _difference(last, logged)
        if wrong:
            raise FailureError(
                f"{path}: step {logged.step} does not come out as it was logged ({wrong} differs):"
                " this simulator is not the one that began the deployment"
            )
    return last


def _difference(step: JointStep, logged: JointStep) -> str | None:
    """Name of the first field that differs in a bit; None if all are equal."""
    for field in fields(JointStep):
        mine, theirs = getattr(step, field.name), getattr(logged, field.name)
        if isinstance(mine, np.ndarray):
            mine, theirs = (mine,), (theirs,)
        elif not (isinstance(mine, tuple) and isinstance(mine[0], np.ndarray)):
            if mine != theirs:
                return field.name
            continue
        for a, b in zip(mine, theirs, strict=True):
            if a.tobytes() != b.tobytes():
                return field.name
    return None
