"""Names, versions and limits of the deployment log, and the checksum of its metadata.

A log is an MCAP file (https://mcap.dev/spec). Whatever lies in it is covered by a checksum:
steps by one inside each record, metadata by one inside each map, chunks and the summary by MCAP.

From version 2 on the checksums of steps and tables begin with the header's `binding`, so that they
hold in no other log: what a power cut or a mistake put there from elsewhere is no step of this one.
In version 1 they begin with nothing, as MCAP's do. Who can write a log can write any checksum:
they show damage and mix-ups, not forgeries.

In version 3 steps say also which deadlines were missed (`JointStep.held`, `late`). It is written
where a deployment goes by a clock (deployment.rate_hz), and version 2 everywhere else.
"""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from otc_dist.terminal.errors import UserError

FORMAT_VERSION = 3
FIRST_TIMED_VERSION = 3
UNTIMED_VERSION = 2  # of what is written without a clock
MINIMUM_FORMAT_VERSION = 1  # the oldest version that this code still reads
FIRST_BOUND_VERSION = 2

PROFILE = "x-otc-dist"
TOPIC = "joint_step"
SCHEMA = "otc_dist.JointStep"
HEADER = "otc_dist.header"
POLICIES = "otc_dist.policies"
EPISODES = "otc_dist.episodes"
RANGES = "otc_dist.ranges"  # only where steps are missing
RECOVERED = "otc_dist.recovered"  # only in a log made of what was whole of another file

PARTIAL_SUFFIX = ".partial"
HEAD = 2**12  # bytes at a file's begin that `no_log` looks at
MAXIMUM_RECORD = 64 * 2**20  # bytes of one record; a larger length is damage, not data
MAXIMUM_SUMMARY = 64 * 2**20  # bytes of the index at a finished log's end: that of 40 GB of steps
CHUNK_SIZE = 256 * 2**10  # bytes before compression: what a reader decompresses to get one step

_RECORD = struct.Struct("<BQ")  # opcode, length


class DamagedLogError(UserError):
    """A checksum or the framing of a log does not hold. Steps read before this are right."""

    def __init__(self, path: Path, what: str) -> None:
        super().__init__(f"{path} is damaged: {what}")


def partial_path(path: Path) -> Path:
    """Where the log that will end up at `path` lies while it is being written."""
    return path.with_name(path.name + PARTIAL_SUFFIX)


def existing(path: Path) -> Path:
    """`path`, or where its log lies while it is unfinished, if that is what there is."""
    partial = partial_path(path)
    return partial if not path.exists() and partial.exists() else path


def no_log(head: bytes, size: int) -> str | None:
    """Why a file cannot be a log with all of its header, if its first bytes already show it.

    Args:
        head: the first `HEAD` bytes of the file, or all.
        size: of the file.
    """
    if not size:
        return "is empty, and not an MCAP file"
    short = f"is too short to hold the header of a deployment log: {size:,} bytes"
    magic = head[: len(MCAP0_MAGIC)]
    if magic != MCAP0_MAGIC:
        return short if MCAP0_MAGIC.startswith(magic) else "is not an MCAP file"
    at = len(MCAP0_MAGIC)
    for opcode in (Opcode.HEADER, Opcode.METADATA):  # the file's own, and ours after it
        if size < at + _RECORD.size:
            return short
        if len(head) < at + _RECORD.size:
            return None
        found, length = _RECORD.unpack_from(head, at)
        if found != opcode or length > MAXIMUM_RECORD:
            return None
        at += _RECORD.size + length
    return short if size < at else None


def seal(entries: Mapping[str, str], binding: int = 0) -> dict[str, str]:
    """`entries` with their checksum under the key "crc32"; `binding` is that of the header.

    The header itself has none: it says what the others are bound to.
    """
    return {**entries, "crc32": _checksum(entries, binding)}


def unseal(entries: Mapping[str, str], binding: int = 0) -> dict[str, str] | None:
    """What was sealed with the same `binding`, or None if a byte of it has changed."""
    opened = dict(entries)
    checksum = opened.pop("crc32", None)
    return opened if checksum == _checksum(opened, binding) else None


def _checksum(entries: Mapping[str, str], binding: int) -> str:
    # Two NULs end every string: neither keys nor values can move from one to the other unseen.
    text = "".join(f"{key}\0\0{entries[key]}\0\0" for key in sorted(entries))
    return f"{zlib.crc32(text.encode(), binding):08x}"
