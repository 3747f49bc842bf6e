"""supervision.json: how each process of a run is, for anyone who asks while it runs."""

import json
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from otc_dist.run.folder import RunFolder
from otc_dist.system import durable, records

from ..supervise.health import State
from .board import Board

EVERY = 0.5  # seconds between two writings while nothing happens


@dataclass(frozen=True)
class ProcessState:
    """How one process is, and what it does."""

    health: str  # see `health.ProcessHealth`
    seconds: float  # in this state
    pid: int
    restarts: int
    last_end: str
    phase: str
    deployment: int
    done: int
    of: int
    rate: float  # of `done`, a second
    metrics: dict[str, float]


@dataclass(frozen=True)
class Supervision:
    """The contents of supervision.json."""

    launcher: int  # its process id
    written: str  # UTC, ISO 8601
    seconds_left: float | None
    processes: dict[str, ProcessState]

    @classmethod
    def read(cls, folder: RunFolder) -> Self | None:
        """None before the processes of a run are started the first time.

        Raises:
            UserError: the file is damaged.
        """
        try:
            return records.read_json(cls, folder.supervision)
        except FileNotFoundError:
            return None


class SupervisionFile:
    """Writes supervision.json while a run goes. A full disk stops the writing, never the run."""

    def __init__(self, folder: RunFolder) -> None:
        self._path: Path = folder.supervision
        self._last = -EVERY
        self._written: dict[str, State] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        with suppress(OSError):
            self._path.unlink(missing_ok=True)

    def write(self, board: Board) -> None:
        """Replace the file in one step: at once if a process is in another state, else at times."""
        now, known = (
            time.monotonic(),
            {name: process.state for name, process in board.of_process.items()},
        )
        if now - self._last < EVERY and known == self._written:
            return
        self._last, self._written = now, known
        states = {}
        for name, process in board.of_process.items():
            status = board.newest.get(name)
            states[name] = ProcessState(
                health=process.state,
                seconds=round(now - process.since, 1),
                pid=process.pid,
                restarts=process.restarts,
                last_end=process.last_end,
                phase=status.phase if status else "starting",
                deployment=status.deployment if status else 0,
                done=status.update if status else 0,
                of=status.total if status else 0,
                rate=round(status.rate, 1) if status else 0.0,
                metrics=dict(board.measures.get(name, {})),
            )
        written = datetime.now(UTC).isoformat(timespec="milliseconds")
        supervision = Supervision(os.getpid(), written, board.seconds_left, states)
        content = (json.dumps(asdict(supervision)) + "\n").encode()
        with suppress(OSError), durable.writing(self._path, lasting=False) as file:
            file.write(content)
