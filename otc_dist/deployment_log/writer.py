"""Write a deployment's log ahead: a step is in the file before the next one is published."""

import os
import time
from collections.abc import Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path

from mcap.writer import Writer

from otc_dist.deployment_log.finishing import begin, write_finished
from otc_dist.deployment_log.format import DamagedLogError, partial_path
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.record import StepEncoder
from otc_dist.system import durable, locks
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep

# To force a step to the disk takes microseconds or milliseconds, depending on the disk. It is done
# after each step where that takes no more than this share of the time; else as often as it may, but
# at least once in so many seconds.
_SYNCING = 0.05
_LONGEST_PAUSE = 1.0


class LogWriter:
    """Writes the log of one deployment, to `PATH.partial` until `finish` moves it to `PATH`.

    Each step is handed to the system before `write` returns, so that a killed process loses
    nothing; and it is forced to the disk as often as that costs little, so that a power cut takes
    the steps of a moment (docs/faults.md). Opened by `create` or `resume`.
    """

    def __init__(self, path: Path, header: LogHeader, file: int, steps: int, last: int) -> None:
        self.path, self.header = path, header
        self.steps = steps  # the next step's number
        self._layout = header.layout()
        self._encoder = StepEncoder(self._layout)
        self._file = file
        self._size = os.lseek(file, 0, os.SEEK_END)
        self._last_time = last
        self._due = 0.0  # when to force steps to the disk next, by the monotonic clock

    @classmethod
    def create(cls, path: Path, header: LogHeader) -> "LogWriter":
        """Begin the log that will be finished as `path`. Folders are made.

        Raises:
            FileExistsError: there is a log already, finished or not.
            UserError: a step of so many copies does not fit into a record.
            OSError: the disk is full, ...
        """
        partial, prologue = partial_path(path), _prologue(header)
        for existing in (path, partial):
            if existing.exists():
                raise FileExistsError(f"{existing} exists; a recorded deployment is never replaced")
        durable.write(partial, prologue)  # appears under its name only with a whole header in it
        return cls(path, header, _open_locked(partial), 0, 0)

    @classmethod
    def resume(cls, path: Path) -> "tuple[LogWriter, int]":
        """Go on with an unfinished log; also the number of steps already in it.

        A torn record at the end is cut off, and so is everything from a damaged record on: the
        steps are then taken again, and come out the same.

        Raises:
            FileNotFoundError: there is no unfinished log.
            UserError: another process is writing it, or it is no log that can be read.
        """
        partial = partial_path(path)
        file = _open_locked(partial)
        try:
            with OpenLog(partial) as log:
                steps, last = 0, 0
                with suppress(DamagedLogError):
                    for rows in log.blocks():
                        steps += len(rows)
                        last = int(rows[-1]["log_time"])
                os.ftruncate(file, log.first + steps * log.layout.size)
            return cls(path, log.header, file, steps, last), steps
        except BaseException:
            os.close(file)
            raise

    def write(self, step: JointStep) -> None:
        """Append one step.

        Raises:
            ValueError, TypeError: not the next step, or its arrays are not the team's.
            OSError: the disk is full, ...: the log ends with the step before, and the same step
                may be written again.
        """
        if step.step != self.steps:
            raise ValueError(f"step {step.step} cannot follow {self.steps} steps")
        # Strictly increasing, so that tools that sort by time keep the order of steps.
        log_time = max(time.time_ns(), self._last_time + 1)
        record = self._encoder.encode(step, log_time)
        self._append(record)
        self._last_time = log_time
        self.steps += 1
        self._sync_if_due()

    def _sync_if_due(self) -> None:
        begun = time.monotonic()
        if begun >= self._due:
            os.fdatasync(self._file)
            ended = time.monotonic()
            pause = (ended - begun) * (1 / _SYNCING - 1)
            self._due = ended + min(pause, _LONGEST_PAUSE)

    def _append(self, record: bytes) -> None:
        try:
            written = os.write(self._file, record)
            while written < len(record):
                written += os.write(self._file, record[written:])
        except BaseException:  # also a KeyboardInterrupt: never leave half a record behind
            os.ftruncate(self._file, self._size)
            raise
        self._size += len(record)

    def close(self) -> None:
        """Force what was written to the disk and let go of the unfinished log."""
        if self._file >= 0:
            file, self._file = self._file, -1
            try:
                os.fsync(file)
            finally:
                os.close(file)

    def finish(self, policies: Mapping[str, str]) -> Path:
        """Close the log and make the finished file of it; returns its path.

        See `write_finished` for what is in it.

        Raises:
            OSError: the disk is full, ...: the unfinished log is still there.
            DamagedLogError: what was written does not read back.
        """
        self.close()
        partial = partial_path(self.path)
        with OpenLog(partial) as log:
            write_finished(self.path, self.header, log.blocks, policies)
        partial.unlink()
        return self.path


def _open_locked(partial: Path) -> int:
    """Open for appending, so that no second process writes the same log."""
    file = os.open(partial, os.O_RDWR | os.O_APPEND | os.O_CLOEXEC)
    if not locks.take(file, partial):
        os.close(file)
        raise UserError(f"{partial} is being written by another process") from None
    return file


def _prologue(header: LogHeader) -> bytes:
    out = BytesIO()
    writer = Writer(out, use_chunking=False)
    begin(writer, header)
    writer.flush()  # type: ignore[no-untyped-call]
    return out.getvalue()
