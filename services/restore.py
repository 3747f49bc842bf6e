"""The log of a deployment, opened: at its beginning, or where an unfinished one ends, to which a
simulator is brought by playing the log again.
"""

import logging
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from otc_dist.deployment_log.format import FIRST_TIMED_VERSION, UNTIMED_VERSION, partial_path
from otc_dist.deployment_log.header import LogHeader, versions
from otc_dist.deployment_log.reader import read_steps
from otc_dist.deployment_log.writer import LogWriter
from otc_dist.envs.rollout import Rollout
from otc_dist.system.processor import kind
from otc_dist.transitions import JointStep

from .process import FailureError, Run

log = logging.getLogger(__name__)

_ENDS = ("step", "episode_seeds", "terminated", "truncated")  # which say how an episode goes on


def open_log(run: Run, k: int, rollout: Rollout) -> tuple[LogWriter, JointStep | None]:
    """The log of deployment k to write, and its last step; `rollout` has caught up with it.

    Raises:
        UserError: another process is writing it, or it is no log that can be read.
        FailureError: as `check_begun` and `resimulate`.
    """
    path, description = run.folder.deployment(k), run.description
    timed = description.deployment.rate_hz is not None
    if partial_path(path).exists():
        writer, steps = LogWriter.resume(path)
        try:
            check_begun(writer.header, run.keys.run, k, partial_path(path))
            log.info("deployment %d continues after %d logged steps", k, steps)
            if timed:
                return writer, retrace(rollout, path, steps)
            return writer, resimulate(rollout, path, steps, run.moved)
        except BaseException:
            writer.close()
            raise
    header = LogHeader(
        run=run.keys.run,
        deployment=k,
        seed=description.seed,
        description=description.to_toml(),
        description_digest=description.tuning_digest(),
        team=run.team,
        copies=description.env.copies,
        versions=versions() | dict(rollout.simulator) | {"processor": kind()},
        format_version=FIRST_TIMED_VERSION if timed else UNTIMED_VERSION,
    )
    return LogWriter.create(path, header), None


def check_begun(header: LogHeader, run: str, deployment: int, path: Path) -> None:
    """See that an unfinished log is of that deployment of the run.

    Raises:
        FailureError: it is of another.
    """
    if (header.run, header.deployment) != (run, deployment):
        raise FailureError(
            f"{path} is of run {header.run}, deployment {header.deployment}, not of {run},"
            f" deployment {deployment}: put the right one there, or none"
        )
    if not header.bound:
        log.warning(
            "an older otc_dist began %s: its steps stay unbound to this run (--accept-unbound)",
            path.name,
        )


def resimulate(rollout: Rollout, path: Path, steps: int, moved: bool) -> JointStep | None:
    """Advance a fresh `rollout` by the first `steps` logged steps; returns the last of them.

    Args:
        moved: the run has come to another kind of processor, on which simulators round differently.
            Then each step begins from its logged state, as far as the environment can be set to
            one, and the log stays as it is.

    Raises:
        FailureError: a step does not come out as it was logged, to the bit, or if `moved` an
            episode does not end where it ended.
    """
    last, compared = None, _ENDS if moved else tuple(field.name for field in fields(JointStep))
    for logged in read_steps(path, 0, steps):
        if moved:
            rollout.go_to(logged.state)
        last = rollout.advance(logged.actions, logged.exploring)
        if wrong := _difference(last, logged, compared):
            raise FailureError(
                f"{path}: step {logged.step} does not come out as it was logged ({wrong} differs):"
                " this simulator is not the one that began the deployment"
            )
        last = logged
    return last


def retrace(rollout: Rollout, path: Path, steps: int) -> JointStep | None:
    """Count the first `steps` logged steps of devices, which nothing plays again; the last."""
    last = None
    for last in read_steps(path, 0, steps):
        rollout.take(last)
    return last


def _difference(step: JointStep, logged: JointStep, compared: Sequence[str]) -> str | None:
    """Name of the first of the compared fields that differs in a bit; None if all are equal."""
    for name in compared:
        mine, theirs = getattr(step, name), getattr(logged, name)
        if isinstance(mine, np.ndarray):
            mine, theirs = (mine,), (theirs,)
        elif not (isinstance(mine, tuple) and mine and isinstance(mine[0], np.ndarray)):
            if mine != theirs:
                return name
            continue
        for a, b in zip(mine, theirs, strict=True):
            if a.tobytes() != b.tobytes():
                return name
    return None
