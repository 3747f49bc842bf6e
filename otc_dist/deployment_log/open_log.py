"""A log as blocks of rows, finished or not. What is read has passed its checksum."""

import io
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, ChunkIndex, Header, McapRecord, Metadata
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from otc_dist.deployment_log import chunks
from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.extent import Extent, scheduled_steps
from otc_dist.deployment_log.format import DamagedLogError, existing, unseal
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import CHANNEL_ID, Rows
from otc_dist.system import records
from otc_dist.terminal.errors import UserError

# What parsing bytes that were changed may raise, in the mcap library and below it.
PARSE_ERRORS = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    OSError,  # of a seek to where no file ends
    OverflowError,
    MemoryError,
)
_BLOCK = 2**20  # bytes read at once from an unfinished log
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, summary start, offsets start, CRC-32
_MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, length of its entries
_INDEX_ENTRY = 16  # bytes


def _size(record: McapRecord) -> int:
    builder = RecordBuilder()
    record.write(builder)
    return builder.count


class OpenLog:
    """An open log: `header`, `layout`, `extent`, and its steps as blocks of rows.

    `finished` says whether the file has the form of a finished log; a recovered one has it, too.

    Raises:
        UserError, DamagedLogError: as `read_header`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path = existing(path)
        try:
            self._file: BinaryIO = path.open("rb")
        except IsADirectoryError:
            raise UserError(
                f"{path} is a folder; a run's logs are RUN/deployments/deployment_*.mcap"
            ) from None
        except OSError as error:
            raise UserError(f"{path} cannot be read: {error.strerror}") from None
        try:
            self._open()
        except BaseException:
            self._file.close()
            raise

    def _open(self) -> None:
        self.size = self._file.seek(0, io.SEEK_END)
        self._file.seek(max(self.size - len(MCAP0_MAGIC), 0))
        self.finished = self.size > 2 * len(MCAP0_MAGIC) and self._file.read() == MCAP0_MAGIC
        self._file.seek(0)
        if (reason := fmt.no_log(self._file.read(fmt.HEAD), self.size)) is not None:
            raise UserError(f"{self.path} {reason}")
        self._file.seek(0)
        self.header = self._find_header()
        self.layout = self.header.layout()
        self._summary: Summary | None = self._read_summary() if self.finished else None
        self.extent = self._find_extent()

    def __enter__(self) -> "OpenLog":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _find_header(self) -> LogHeader:
        """The first intact copy of the header.

        Of an unfinished log only the channel's copy counts: right after it, at `first`, the
        steps begin, so where they begin is covered by a checksum, too.
        """
        self.first, before = 0, 0
        try:
            for record in StreamReader(
                self._file, emit_chunks=True, record_size_limit=fmt.MAXIMUM_RECORD
            ).records:
                entries: dict[str, str] | None = None
                if isinstance(record, Header) and record.profile != fmt.PROFILE:
                    raise UserError(
                        f"{self.path} is an MCAP file of profile {record.profile[:40]!r}, not"
                        f" {fmt.PROFILE!r}: otc_dist did not write it"
                    )
                if isinstance(record, Metadata) and record.name == fmt.HEADER and self.finished:
                    entries = unseal(record.metadata)
                elif isinstance(record, Channel) and record.topic == fmt.TOPIC:
                    entries = unseal(record.metadata)
                    self.first = before + _size(record)
                elif isinstance(record, Chunk) and not self.finished:
                    break
                if entries is not None:
                    return LogHeader.from_entries(entries, self.path)
                before = self._file.tell()
        except PARSE_ERRORS:
            pass  # it ends too early, or what was changed does not parse
        raise DamagedLogError(self.path, "its header or its end is not readable")

    def _read_summary(self) -> Summary:
        # The mcap library does not check the summary's CRC.
        footer_size = _FOOTER.size + len(MCAP0_MAGIC)
        self._file.seek(self.size - footer_size)
        footer = self._file.read(_FOOTER.size)
        opcode, _, start, _, checksum = _FOOTER.unpack(footer)
        length = self.size - footer_size - start
        if opcode == Opcode.FOOTER and start > 0 and 0 <= length <= fmt.MAXIMUM_SUMMARY:
            self._file.seek(start)
            covered = self._file.read(length) + footer[:-4]
            if zlib.crc32(covered) == checksum:
                self._file.seek(0)
                reader = SeekingReader(self._file, record_size_limit=fmt.MAXIMUM_RECORD)
                try:
                    summary = reader.get_summary()
                except PARSE_ERRORS:
                    raise DamagedLogError(self.path, "its index cannot be read") from None
                if summary is not None and summary.statistics is not None:
                    return summary
        raise DamagedLogError(self.path, "its index does not match its checksum")

    def metadata(self, name: str) -> dict[str, str]:
        """The entries of a finished log's metadata record `name`. Raises DamagedLogError."""
        if self._summary is not None:
            for index in self._summary.metadata_indexes:
                if index.name == name:
                    entries = unseal(self._metadata_at(index.offset), self.header.binding)
                    if entries is not None:
                        return entries
        raise DamagedLogError(self.path, f"its record {name!r} is not readable")

    def _metadata_at(self, offset: int) -> dict[str, str]:
        try:
            self._file.seek(offset)
            record = next(
                StreamReader(
                    self._file, skip_magic=True, record_size_limit=fmt.MAXIMUM_RECORD
                ).records
            )
        except PARSE_ERRORS:
            return {}
        return record.metadata if isinstance(record, Metadata) else {}

    def _find_extent(self) -> Extent:
        names = [index.name for index in self._summary.metadata_indexes] if self._summary else []
        ranges = self._table_of_ranges() if fmt.RANGES in names else [(0, self.steps())]
        scheduled, finished = scheduled_steps(self.header), self.finished
        recovered = fmt.RECOVERED in names
        if recovered:
            finished = self.metadata(fmt.RECOVERED).get("from") == "finished"
        return Extent(ranges, scheduled, finished, recovered)

    def _table_of_ranges(self) -> list[tuple[int, int]]:
        table = self.metadata(fmt.RANGES).get("ranges", "")
        found = records.from_json(list[tuple[int, int]], table, f"{self.path}: its table of gaps")
        bounds = [bound for pair in found for bound in pair]
        if not bounds or bounds[0] < 0 or bounds != sorted(set(bounds)):
            raise UserError(f"{self.path}: its table of gaps is not in order")
        return found

    def steps(self) -> int:
        """Number of steps. Of an unfinished log: of its complete records, checksums unread."""
        if self._summary is None or self._summary.statistics is None:
            return (self.size - self.first) // self.layout.size
        return self._summary.statistics.channel_message_counts.get(CHANNEL_ID, 0)

    def times(self) -> tuple[int, int] | None:
        """When the first and the last step were logged, ns since the epoch; None without steps."""
        if not self.steps():
            return None
        if self._summary is not None and self._summary.statistics is not None:
            statistics = self._summary.statistics
            return statistics.message_start_time, statistics.message_end_time
        ends = [next(self._unchunked(step, step + 1, 0)) for step in (0, self.steps() - 1)]
        return int(ends[0][0]["log_time"]), int(ends[1][0]["log_time"])

    def blocks(self, start: int = 0, stop: int | None = None) -> Iterator[Rows]:
        """Steps start..stop-1, as far as there are, as structured rows, some at a time.

        Raises:
            DamagedLogError: after the last step before the damage.
        """
        before = 0  # steps of the ranges before
        for low, high in self.extent.ranges:
            first = max(start, low)
            end = high if stop is None else min(stop, high)
            if first < end:
                read = self._chunked if self.finished else self._unchunked
                yield from read(first, end, low - before)
            before += high - low

    def _unchunked(self, start: int, end: int, shift: int) -> Iterator[Rows]:
        size = self.layout.size
        per_block = max(1, _BLOCK // size)
        for first in range(start, end, per_block):
            # pread: the file's position stays out of it, so a log may be read while it grows.
            data = os.pread(
                self._file.fileno(),
                size * (min(first + per_block, end) - first),
                self.first + (first - shift) * size,
            )
            yield from self._checked(data, first)

    def _chunked(self, start: int, end: int, shift: int) -> Iterator[Rows]:
        """Steps start..end-1, which lie one after another; the log's n-th step is n + shift."""
        size, first = self.layout.size, shift
        for index in self._summary.chunk_indexes if self._summary else ():
            if first >= end:
                return
            count = self._messages_in(index)
            if count and first + count > start:
                data = self._records_of(index)
                if len(data) != count * size:
                    raise DamagedLogError(self.path, f"the chunk that begins at step {first}")
                low, high = max(start - first, 0), min(end - first, count)
                yield from self._checked(memoryview(data)[low * size : high * size], first + low)
            first += count
        if first < end:
            raise DamagedLogError(self.path, f"steps from {first} on are missing")

    def _checked(self, data: bytes | memoryview, first: int) -> Iterator[Rows]:
        size = self.layout.size
        intact = self.layout.intact(data, first)
        if intact:
            yield self.layout.rows(memoryview(data)[: intact * size])
        if intact * size != len(data):
            raise DamagedLogError(self.path, f"step {first + intact} does not match its checksum")

    def _messages_in(self, index: ChunkIndex) -> int:
        """Steps in a chunk, from the head of its message index."""
        offset = index.message_index_offsets.get(CHANNEL_ID)
        if offset is None:
            return 0
        try:
            self._file.seek(offset)
            head = self._file.read(_MESSAGE_INDEX.size)
            opcode, _, channel, length = _MESSAGE_INDEX.unpack(head)
        except PARSE_ERRORS:
            opcode, channel, length = 0, 0, 0
        if opcode != Opcode.MESSAGE_INDEX or channel != CHANNEL_ID:
            raise DamagedLogError(self.path, "a message index is not where the index says")
        return int(length) // _INDEX_ENTRY

    def _records_of(self, index: ChunkIndex) -> bytes:
        """The records of our channel in a chunk, joined."""
        try:
            self._file.seek(index.chunk_start_offset)
            reader = StreamReader(
                self._file,
                skip_magic=True,
                emit_chunks=True,
                record_size_limit=fmt.MAXIMUM_RECORD,
            )
            chunk = next(reader.records)
            if not isinstance(chunk, Chunk):
                raise ValueError("no chunk")
            data = chunks.contents(chunk, self.layout.size)
        except StopIteration:
            raise DamagedLogError(self.path, "it ends within a chunk") from None
        except PARSE_ERRORS as error:
            raise DamagedLogError(self.path, str(error)) from None
        prefix, size, found, at = self.layout.prefix, self.layout.size, [], 0
        while at < len(data):
            if data.startswith(prefix, at):
                found.append(data[at : at + size])
            at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        return b"".join(found)
