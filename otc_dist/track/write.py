"""Writes a run to a tracker: what it holds so far, and what comes until it ends."""

import json
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from otc_dist.description import Description
from otc_dist.report import files
from otc_dist.run.folder import RunFolder
from otc_dist.system import locks
from otc_dist.terminal.errors import UserError, os_error_line
from otc_dist.track.points import GREEDY, MEASURED, Points
from otc_dist.track.trackers import About, open_tracker

_LOOK = 2.0  # seconds between two looks at the run's folder
_LOCK = ".otc_dist.lock"


def write(
    folder: RunFolder, name: str, out: Path, ended: threading.Event | None = None
) -> list[str]:
    """Write a run to the tracker `name`; what had to be left out, a line each.

    Args:
        out: where the tracker is; made if it is not there.
        ended: go on until the run has ended, or this is set; None: only what is there.

    Raises:
        OSError, UserError: `folder` is no run's, the tracker cannot be written, or another process
            is writing it.
    """
    files.run_record(folder)  # else it is no run's
    points = Points(folder)
    with _held(folder, out), _one_line_errors(out):
        tracker = open_tracker(name, out, _about(folder))
        try:
            while True:
                # Looked at before the points: those of its last moment are read as well.
                last = ended is None or ended.is_set() or _state(folder) not in files.GOING_ON
                for each in points.new():
                    tracker.log(each.source, each.step, each.values)
                tracker.flush()
                if last or ended is None:
                    break
                ended.wait(_LOOK)
        finally:
            tracker.close()
    return list(points.problems.values())


def _state(folder: RunFolder) -> str:
    return files.run_record(folder).get("state", "")


def _about(folder: RunFolder) -> About:
    record = files.run_record(folder)
    return About(
        name=folder.root.name,
        identity=f"{record.get('run', folder.root.name)} {record.get('started', '')}",
        settings=dict(_flat(Description.load(folder.description).model_dump(mode="json"))),
        results=(GREEDY, MEASURED),
    )


def _flat(
    values: Mapping[str, object], prefix: str = ""
) -> Iterator[tuple[str, str | int | float | bool]]:
    """Settings by their names as `--set` has them."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, str | int | float | bool):
            yield f"{prefix}{key}", value
        elif value is not None:
            yield f"{prefix}{key}", json.dumps(value)


@contextmanager
def _one_line_errors(out: Path) -> Iterator[None]:
    """Name the folder where the system does not, and leave it at one line.

    TensorBoard's writer has a thread, whose error comes to us as well as to the terminal.
    """

    def hook(ended: threading.ExceptHookArgs) -> None:
        if not issubclass(ended.exc_type, OSError):
            before(ended)

    before, threading.excepthook = threading.excepthook, hook
    try:
        yield
    except OSError as error:
        if error.filename:
            raise
        raise UserError(f"cannot write {out}: {os_error_line(error)}") from None
    finally:
        threading.excepthook = before


@contextmanager
def _held(folder: RunFolder, out: Path) -> Iterator[None]:
    """Make `out`, and hold it against another process that would write the same points."""
    if out.is_relative_to(folder.root) and not folder.root.is_dir():
        raise UserError(f"{folder.root} is gone")  # a run that was refused takes its folder away
    out.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(out / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        if not locks.take(descriptor, out / _LOCK):
            raise UserError(f"another process is writing to {out}: wait, or use another --out")
        yield
    finally:
        os.close(descriptor)
