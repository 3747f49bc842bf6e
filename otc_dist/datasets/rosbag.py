"""Reading the messages of a rosbag2 recording in MCAP, CDR by `mcap-ros2-support`."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from otc_dist.datasets.ros_mapping import Numbers
from otc_dist.deployment_log import chunks
from otc_dist.deployment_log.open_log import PARSE_ERRORS
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float64

_LARGEST_CHUNK = 2**26  # bytes; rosbag2's take about 2^20, or one camera's picture
_LARGEST_RECORD = 2**28  # bytes
_DAMAGE = (
    *PARSE_ERRORS,
    RecursionError,
    AttributeError,
    TypeError,
    IndexError,
    NotImplementedError,
)
_STEP = re.compile(r"([A-Za-z0-9_]+)(?:\[([0-9]+)\])?")


@dataclass(frozen=True)
class Series:
    """What one field was, message after message."""

    times: NDArray[np.int64]  # (n,) ascending, nanoseconds
    values: Float64  # (n, size)


@dataclass(frozen=True)
class Bag:
    """What was read of a recording."""

    times: Mapping[str, NDArray[np.int64]]  # of the messages of each topic that was asked for
    series: Mapping[Numbers, Series]
    others: tuple[str, ...]  # topics that nobody asked for


def files_of(source: Path) -> list[Path]:
    """The MCAP files of a recording: the file itself, or those in its folder. UserError: none."""
    found = sorted(source.glob("*.mcap")) if source.is_dir() else [source]
    if not found or not found[0].is_file():
        raise UserError(
            f"no MCAP file {source}" if not source.is_dir() else f"no *.mcap in {source}"
        )
    return found


def read(files: Collection[Path], wanted: Collection[Numbers], clock: str) -> Bag:
    """Read fields of a recording.

    Raises:
        UserError: `mcap-ros2-support` is not installed; damage, a topic or field that is missing
            or holds no numbers, a message as long as no other of its topic.
    """
    topics = {numbers.topic for numbers in wanted} | {clock}
    found: dict[str, list[tuple[int, dict[Numbers, list[float]]]]] = {name: [] for name in topics}
    others: set[str] = set()
    for path in files:
        decoders = _Decoders(path)
        try:
            for channel, schema, message in _messages(path):
                if channel.topic not in topics:
                    others.add(channel.topic)
                    continue
                decoded = decoders.of(channel, schema)(message.data)
                mine = [numbers for numbers in wanted if numbers.topic == channel.topic]
                values = {numbers: _values(decoded, numbers, path) for numbers in mine}
                found[channel.topic].append((message.log_time, values))
        except _DAMAGE as error:
            reason = (str(error) or type(error).__name__).splitlines()[0]
            raise UserError(f"{path} cannot be read as rosbag2's MCAP: {reason}") from None
    return _bag(found, wanted, others, next(iter(files)))


def _bag(
    found: Mapping[str, list[tuple[int, dict[Numbers, list[float]]]]],
    wanted: Collection[Numbers],
    others: Collection[str],
    path: Path,
) -> Bag:
    for topic, messages in found.items():
        if not messages:
            known = f"; there are {', '.join(sorted(others)[:8])}" if others else ""
            raise UserError(f"{path} has no message of {topic}{known}")
        messages.sort(key=lambda message: message[0])
    times = {
        topic: np.array([time for time, _ in messages], np.int64)
        for topic, messages in found.items()
    }
    series = {}
    for numbers in wanted:
        rows = [values[numbers] for _, values in found[numbers.topic]]
        if odd := next((i for i, row in enumerate(rows) if len(row) != len(rows[0])), 0):
            raise UserError(
                f"{path}: {numbers} has {len(rows[odd])} numbers in message {odd}, and"
                f" {len(rows[0])} in the first one"
            )
        series[numbers] = Series(times[numbers.topic], np.array(rows, np.float64))
    return Bag(times, series, tuple(sorted(others)))


def _messages(path: Path) -> Iterator[tuple[Channel, Schema | None, Message]]:
    """Each with its channel and schema, in the file's order; no chunk inflates beyond its size."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in _records(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            yield channel, schemas.get(channel.schema_id), record


def _records(path: Path) -> Iterator[McapRecord]:
    with closing(path.open("rb")) as file:
        outer = StreamReader(file, emit_chunks=True, record_size_limit=_LARGEST_RECORD)
        for record in outer.records:
            if not isinstance(record, Chunk):
                yield record
                continue
            data = chunks.contents(record, _LARGEST_CHUNK - chunks.LARGEST)
            stream = BytesIO(data)
            inner = StreamReader(stream, skip_magic=True, record_size_limit=len(data)).records
            while stream.tell() < len(data):
                yield next(inner)


class _Decoders:
    """Decoders of a file's messages, by their schemas."""

    def __init__(self, path: Path) -> None:
        try:
            from mcap_ros2.decoder import DecoderFactory
        except ImportError:
            need = "importing a ROS 2 recording needs mcap-ros2-support"
            raise UserError(f"{need}: {install('ros2')}") from None
        self._path, self._factory = path, DecoderFactory()

    def of(self, channel: Channel, schema: Schema | None) -> Callable[[bytes], Any]:
        """Raises UserError: its messages are not ROS 2's."""
        found: Callable[[bytes], Any] | None
        found = self._factory.decoder_for(channel.message_encoding, schema)
        if found is None:
            encodings = f"{channel.message_encoding!r}, {schema.encoding if schema else None!r}"
            raise UserError(
                f"{self._path}: {channel.topic} is encoded as {encodings}, not 'cdr', 'ros2msg'"
            )
        return found


def _values(message: Any, numbers: Numbers, path: Path) -> list[float]:
    """The numbers that a field of a message holds."""
    found = message
    for step in numbers.field.split("."):
        name, index = _STEP.fullmatch(step).groups()  # type: ignore[union-attr]  # by the mapping
        if not hasattr(found, name):
            raise UserError(f"{path}: {numbers.topic} has no field {numbers.field}")
        found = getattr(found, name)
        if index is not None:
            if not hasattr(found, "__len__") or int(index) >= len(found):
                raise UserError(f"{path}: {numbers} is not in a message: it is too short")
            found = found[int(index)]
    try:
        if isinstance(found, bytes | bytearray | memoryview):  # uint8[]
            found = np.frombuffer(found, np.uint8)
        array = np.atleast_1d(np.asarray(found))
        if array.dtype.kind not in "biuf" or array.ndim != 1:
            raise ValueError
    except (ValueError, TypeError):
        raise UserError(f"{path}: {numbers} holds no numbers") from None
    values: list[float] = array.astype(np.float64).tolist()
    return values
