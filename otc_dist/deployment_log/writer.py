"""Write a deployment's log ahead: a step is in the file before the next one is published."""

import fcntl
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import mcap
from mcap.writer import CompressionType, Writer

import otc_dist
from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.episodes import find_episodes, to_json
from otc_dist.deployment_log.format import DamagedLogError, partial_path, seal
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.reader import OpenLog
from otc_dist.deployment_log.record import CHANNEL_ID, PAYLOAD_START, RecordLayout, StepEncoder
from otc_dist.errors import UserError
from otc_dist.transitions import JointStep

# An fsync takes milliseconds. One at each episode's end is what we want, but where episodes are
# short or copies are many it would slow the lock-step: not more often than this, in seconds.
SYNC_INTERVAL = 0.25


class LogWriter:
    """Writes the log of one deployment, to `PATH.partial` until `finish` moves it to `PATH`.

    Each step is handed to the system before `write` returns, so that a killed process loses
    nothing; at an episode's end, at most four times a second, it is forced to the disk, so that
    a power cut loses little. Opened by `create` or `resume`.
    """

    def __init__(self, path: Path, header: LogHeader, file: int, steps: int, last: int) -> None:
        self.path, self.header = path, header
        self.steps = steps  # the next step's number
        self._layout = RecordLayout(header.team, header.copies)
        self._encoder = StepEncoder(self._layout)
        self._file = file
        self._size = os.lseek(file, 0, os.SEEK_END)
        self._last_time = last
        self._synced = time.monotonic()

    @classmethod
    def create(cls, path: Path, header: LogHeader) -> "LogWriter":
        """Begin the log that will be finished as `path`. Folders are made.

        Raises:
            FileExistsError: there is a log already, finished or not.
            UserError: a step of so many copies does not fit into a record.
            OSError: the disk is full, ...
        """
        partial, prologue = partial_path(path), _prologue(header)
        path.parent.mkdir(parents=True, exist_ok=True)
        for existing in (path, partial):
            if existing.exists():
                raise FileExistsError(f"{existing} exists; a recorded deployment is never replaced")
        # Appears under its name only with a whole header in it.
        temporary = path.with_name(path.name + ".new")
        with temporary.open("wb") as stream:
            stream.write(prologue)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.rename(partial)
        _sync_folder(path.parent)
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
        now = time.monotonic()
        if now - self._synced >= SYNC_INTERVAL and (step.terminated | step.truncated).any():
            os.fsync(self._file)
            self._synced = now

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

        The steps' payloads stay the same to the byte. Chunked, compressed, indexed, with CRCs
        over chunks, data and summary; `policies` (agent -> digest of the policy that acted) and
        the table of episodes are added.

        Raises:
            OSError: the disk is full, ...: the unfinished log is still there.
            DamagedLogError: what was written does not read back.
        """
        self.close()
        partial, temporary = partial_path(self.path), self.path.with_name(self.path.name + ".new")
        try:
            with OpenLog(partial) as log, temporary.open("wb") as stream:
                writer = Writer(
                    stream,
                    chunk_size=fmt.CHUNK_SIZE,
                    compression=CompressionType.ZSTD,
                    enable_data_crcs=True,
                )
                _begin(writer, self.header)
                for rows in log.blocks():
                    for row in rows:
                        writer.add_message(
                            channel_id=CHANNEL_ID,
                            log_time=int(row["log_time"]),
                            publish_time=int(row["publish_time"]),
                            sequence=int(row["step"]),
                            data=row.tobytes()[PAYLOAD_START:],
                        )
                episodes = find_episodes(log.blocks(), len(self.header.team.agents))
                writer.add_metadata(fmt.POLICIES, seal(policies))
                writer.add_metadata(fmt.EPISODES, seal({"episodes": to_json(episodes)}))
                writer.finish()  # type: ignore[no-untyped-call]
                stream.flush()
                os.fsync(stream.fileno())
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        temporary.rename(self.path)
        _sync_folder(self.path.parent)
        partial.unlink()
        return self.path


def _open_locked(partial: Path) -> int:
    """Open for appending, so that no second process writes the same log."""
    file = os.open(partial, os.O_RDWR | os.O_APPEND | os.O_CLOEXEC)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        raise UserError(f"{partial} is being written by another process") from None
    return file


def _begin(writer: Writer, header: LogHeader) -> None:
    """What stands before the steps, in the unfinished and in the finished log."""
    entries = seal(header.to_entries())
    layout = RecordLayout(header.team, header.copies)
    writer.start(fmt.PROFILE, f"otc_dist {otc_dist.__version__}, mcap-python {mcap.__version__}")
    writer.add_metadata(fmt.HEADER, entries)
    schema = writer.register_schema(fmt.SCHEMA, "jsonschema", layout.schema())
    channel = writer.register_channel(fmt.TOPIC, "msgpack", schema, metadata=entries)
    if channel != CHANNEL_ID:
        raise RuntimeError(f"the channel's id is {channel}, not {CHANNEL_ID}")


def _prologue(header: LogHeader) -> bytes:
    out = BytesIO()
    writer = Writer(out, use_chunking=False)
    _begin(writer, header)
    writer.flush()  # type: ignore[no-untyped-call]
    return out.getvalue()


def _sync_folder(folder: Path) -> None:
    """Make a rename in `folder` durable."""
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
