"""What is whole in a log that is damaged, cut off or unfinished: found without its index.

Nothing but the checksums of the steps is trusted. A step is looked for by the bytes that all
records of a log begin with: in the file as it lies, where unfinished logs have it, and in every
Zstandard frame, where finished ones do. A damaged frame still gives the blocks before the damage.
"""

import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.writer import MCAP0_MAGIC

from otc_dist.deployment_log import chunks
from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.format import unseal
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import Rows
from otc_dist.errors import UserError

_FRAME_MAGIC = bytes.fromhex("28b52ffd")  # RFC 8878
_BLOCK = 2**20  # bytes of steps given at once
_RECORD_HEAD = 9  # bytes of a record's opcode and length
_LAST_TIME = 2**63  # ns since the epoch; a time behind it is damage
_UINT32 = struct.Struct("<I")

_Bytes = bytes | bytearray | mmap.mmap


class Salvage:
    """An open log, of which no byte is trusted: its header, and its steps that are whole.

    Raises:
        UserError: it cannot be read, no copy of its header is whole, or it is of a version that
            is not read.
    """

    def __init__(self, path: Path) -> None:
        try:
            with path.open("rb") as stream:
                self._data = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise UserError(f"{path} is empty") from None
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror}") from None
        self.path, self.size = path, len(self._data)
        self.searched = 0  # bytes, while `blocks` is under way
        self.header = self._find_header()
        self.layout = self.header.layout()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._data.close()

    def _find_header(self) -> LogHeader:
        metadata, channel = _string(fmt.HEADER), _string(fmt.TOPIC) + _string("msgpack")
        for marker in (metadata, channel):
            for entries in _maps_behind(marker, self._data):
                return LogHeader.from_entries(entries, self.path)
        for frame in self._frames():  # the channel also stands in the first chunk
            for entries in _maps_behind(channel, frame):
                return LogHeader.from_entries(entries, self.path)
        raise UserError(f"{self.path} {self._what_else()}")

    def _what_else(self) -> str:
        """Why a file without a header of ours may have none."""
        start = len(MCAP0_MAGIC) + _RECORD_HEAD
        if self._data[: len(MCAP0_MAGIC)] != MCAP0_MAGIC:
            return "is not an MCAP file, and holds no whole header of a deployment log"
        if self._data[start : start + 4 + len(fmt.PROFILE)] != _string(fmt.PROFILE):
            return f"is an MCAP file, but not of profile {fmt.PROFILE!r}: otc_dist did not write it"
        return "holds no whole header of a deployment log"

    def policies(self) -> dict[str, str]:
        """Agent -> digest of the policy that acted; empty if that is not readable."""
        return next(_maps_behind(_string(fmt.POLICIES), self._data, self.header.binding), {})

    def blocks(self) -> Iterator[Rows]:
        """All steps that are whole, in order; where some are missing, a block's steps skip them."""
        held: list[bytes] = []
        last, last_time = -1, 0
        for record in self._records(self._data, frames=True):
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

    def _records(self, data: _Bytes, *, frames: bool) -> Iterator[bytes]:
        """Whole records in `data`, as they lie, and in its Zstandard frames if `frames`."""
        prefix, size = self.layout.prefix, self.layout.size
        record_at = data.find(prefix)
        frame_at = data.find(_FRAME_MAGIC) if frames else -1
        while record_at >= 0 or frame_at >= 0:
            if frame_at >= 0 and not 0 <= record_at < frame_at:
                self.searched = frame_at
                frame = self._frame(frame_at, chunks.LARGEST + self.layout.size)
                yield from self._records(frame, frames=False)
                frame_at = data.find(_FRAME_MAGIC, frame_at + 1)
                continue
            record = bytes(data[record_at : record_at + size])
            whole = self.layout.step_of(record) is not None
            if whole:
                yield record
            record_at = data.find(prefix, record_at + (size if whole else 1))

    def _frames(self) -> Iterator[bytearray]:
        at = self._data.find(_FRAME_MAGIC)
        while at >= 0:
            yield self._frame(at, chunks.LARGEST)  # which begins with the channel
            at = self._data.find(_FRAME_MAGIC, at + 1)

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


def _maps_behind(marker: bytes, data: _Bytes, binding: int = 0) -> Iterator[dict[str, str]]:
    """The maps of strings behind `marker` whose checksum holds."""
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
