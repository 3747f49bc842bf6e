"""What is whole in a log that is damaged, cut off or unfinished: found without its index.

Nothing but the checksums of the steps is trusted. A step is looked for by the bytes that all
records of a log begin with: in the file as it lies, where unfinished logs have it, and in every
Zstandard frame, where finished ones do. A damaged frame still gives the blocks before the damage.
"""

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

from mcap.writer import MCAP0_MAGIC

from otc_dist.deployment_log import chunks
from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.extent import Source
from otc_dist.deployment_log.format import unseal
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import Rows
from otc_dist.terminal.errors import UserError

_FRAME_MAGIC = bytes.fromhex("28b52ffd")  # RFC 8878
_BLOCK = 2**20  # bytes of steps given at once
_RECORD_HEAD = 9  # bytes of a record's opcode and length
_LAST_TIME = 2**63  # ns since the epoch; a time after it is damage
_UINT32 = struct.Struct("<I")

_Bytes = bytes | bytearray | mmap.mmap


class _Run(NamedTuple):
    """Where steps lie one after another: `records` of them at a place, or in a frame there (0)."""

    first: int  # step
    at: int
    records: int


class Salvage:
    """An open log, of which no byte is trusted: its header, and its steps that are whole.

    Raises:
        UserError: it cannot be read, no copy of its header is whole, or it is of a version that
            is not read.
    """

    def __init__(self, path: Path) -> None:
        path = fmt.existing(path)
        try:
            with path.open("rb") as stream:
                self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise UserError(f"{path} {fmt.no_log(b'', 0)}") from None
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror}") from None
        self.path, self.size = path, len(self._data)
        self.searched = 0  # bytes, while `blocks` is under way
        self._runs: list[_Run] | None = None  # once they are known
        self.header = self._find_header()
        self.layout = self.header.layout()
        self.source = self._find_source()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._data.close()

    def _find_header(self) -> LogHeader:
        metadata, channel = _string(fmt.HEADER), _string(fmt.TOPIC) + _string("msgpack")
        for marker in (metadata, channel):
            for entries in _maps_after(marker, self._data):
                return LogHeader.from_entries(entries, self.path)
        for at in self._frame_places():  # the channel also stands in the first chunk
            for entries in _maps_after(channel, self._frame(at, chunks.LARGEST)):
                return LogHeader.from_entries(entries, self.path)
        raise UserError(f"{self.path} {self._what_else()}")

    def _find_source(self) -> Source:
        """Whether it has its end, or what it was recovered from had."""
        if self._data[-len(MCAP0_MAGIC) :] != MCAP0_MAGIC:
            return "unfinished"
        recovery = next(_maps_after(_string(fmt.RECOVERED), self._data, self.header.binding), {})
        return "unfinished" if recovery.get("from") == "unfinished" else "finished"

    def _what_else(self) -> str:
        """Why a file without a header of ours may have none."""
        start = len(MCAP0_MAGIC) + _RECORD_HEAD
        if self._data[: len(MCAP0_MAGIC)] != MCAP0_MAGIC[: self.size]:
            return "is not an MCAP file, and holds no whole header of a deployment log"
        profile = _string(fmt.PROFILE)
        if self._data[start : start + len(profile)] != profile[: max(self.size - start, 0)]:
            return f"is an MCAP file, but not of profile {fmt.PROFILE!r}: otc_dist did not write it"
        reason = fmt.no_log(self._data[: fmt.HEAD], self.size)
        return reason or "holds no whole header of a deployment log"

    def policies(self) -> dict[str, str]:
        """Agent -> digest of the policy that acted; empty if that is not readable."""
        return next(_maps_after(_string(fmt.POLICIES), self._data, self.header.binding), {})

    def blocks(self) -> Iterator[Rows]:
        """All steps that are whole, in order; where some are missing, a block's steps skip them."""
        held: list[bytes] = []
        last, last_time = -1, 0
        for record in self._in_order():
            row = self.layout.rows(bytearray(record))
            step = int(row["step"][0])
            if step <= last:
                continue  # Zstandard may keep bytes as they are, which are then met twice
            # Times are not under a step's checksum; written twice, they show when one is damaged.
            times = [int(row[name][0]) for name in ("log_time", "publish_time")]
            later = (time for time in times if last_time < time < _LAST_TIME)
            last_time = min(later, default=last_time + 1)
            row["log_time"] = row["publish_time"] = last_time
            last = step
            held.append(row.tobytes())
            if len(held) * self.layout.size >= _BLOCK:
                yield self.layout.rows(b"".join(held))
                held = []
        if held:
            yield self.layout.rows(b"".join(held))

    def _in_order(self) -> Iterator[bytes]:
        """Whole records, by the first step of the run that they lie in: blocks may be displaced."""
        if self._runs is None:
            self._runs = sorted(self._find_runs())
        size = self.layout.size
        for run in self._runs:
            self.searched = run.at
            if run.records:
                for at in range(run.at, run.at + run.records * size, size):
                    yield self._data[at : at + size]
            else:
                frame = self._steps_frame(run.at)
                for at, _ in self._records(frame):
                    yield bytes(frame[at : at + size])

    def _find_runs(self) -> Iterator[_Run]:
        """Stretches of whole records in the file as it lies, and frames that hold any."""
        begin, count, end = (0, 0), 0, (0, 0)  # step and place of the first, and after the last
        for at, step in self._records(self._data):
            if (step, at) != end:
                if count:
                    yield _Run(*begin, count)
                begin, count = (step, at), 0
            count, end = count + 1, (step + 1, at + self.layout.size)
        if count:
            yield _Run(*begin, count)
        for place in self._frame_places():
            self.searched = place
            for _, step in self._records(self._steps_frame(place)):
                yield _Run(step, place, 0)
                break

    def _records(self, data: _Bytes) -> Iterator[tuple[int, int]]:
        """Where whole records are in `data`, as they lie, and which steps they are."""
        prefix, size = self.layout.prefix, self.layout.size
        at = data.find(prefix)
        while at >= 0:
            step = self.layout.step_of(bytes(data[at : at + size]))
            if step is not None:
                yield at, step
            at = data.find(prefix, at + (1 if step is None else size))

    def _frame_places(self) -> Iterator[int]:
        at = self._data.find(_FRAME_MAGIC)
        while at >= 0:
            yield at
            at = self._data.find(_FRAME_MAGIC, at + 1)

    def _steps_frame(self, at: int) -> bytearray:
        return self._frame(at, chunks.LARGEST + self.layout.size)

    def _frame(self, at: int, most: int) -> bytearray:
        """What the Zstandard frame at an offset holds; see `chunks.salvaged`."""
        view = memoryview(self._data)
        source = view[at : at + fmt.MAXIMUM_RECORD]
        try:
            return chunks.salvaged(source, most)
        finally:
            source.release()
            view.release()


def _string(text: str) -> bytes:
    """A string as MCAP writes it."""
    return _UINT32.pack(len(text)) + text.encode()


def _maps_after(marker: bytes, data: _Bytes, binding: int = 0) -> Iterator[dict[str, str]]:
    """The maps of strings after `marker` whose checksum holds."""
    at = data.find(marker)
    while at >= 0:
        opened = unseal(_map_at(data, at + len(marker)), binding)
        if opened is not None:
            yield opened
        at = data.find(marker, at + 1)


def _map_at(data: _Bytes, at: int) -> dict[str, str]:
    """A map of strings at an offset; empty if it is none."""
    try:
        (length,) = _UINT32.unpack_from(data, at)
        content = bytes(data[at + 4 : at + 4 + min(length, fmt.MAXIMUM_RECORD)])
        strings, place = [], 0
        while place < len(content):
            (length,) = _UINT32.unpack_from(content, place)
            strings.append(content[place + 4 : place + 4 + length].decode())
            place += 4 + length
    except (struct.error, UnicodeDecodeError):
        return {}
    return dict(zip(strings[::2], strings[1::2], strict=False))
