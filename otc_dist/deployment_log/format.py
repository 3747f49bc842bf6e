"""Names, versions and limits of the deployment log, and the checksum of its metadata.

A log is an MCAP file (https://mcap.dev/spec). Whatever lies in it is covered by a checksum:
steps by one inside each record, metadata by one inside each map, chunks and the summary by MCAP.

From version 2 on the checksums of steps and tables begin with the header's `binding`, so that they
hold in no other log: what a power cut or a mistake put there from elsewhere is no step of this one.
In version 1 they begin with nothing, as MCAP's do. Who can write a log can write any checksum:
they tell damage and mix-ups, not forgeries.
"""

import zlib
from collections.abc import Mapping
from pathlib import Path

from otc_dist.errors import UserError

FORMAT_VERSION = 2
MINIMUM_FORMAT_VERSION = 1  # the oldest version that this code still reads
FIRST_BOUND_VERSION = 2

PROFILE = "x-otc-dist"
TOPIC = "joint_step"
SCHEMA = "otc_dist.JointStep"
HEADER = "otc_dist.header"
POLICIES = "otc_dist.policies"
EPISODES = "otc_dist.episodes"
RANGES = "otc_dist.ranges"  # only where steps are missing

PARTIAL_SUFFIX = ".partial"
MAXIMUM_RECORD = 64 * 2**20  # bytes of one record; a larger length is damage, not data
MAXIMUM_SUMMARY = 64 * 2**20  # bytes of the index at a finished log's end: that of 40 GB of steps
CHUNK_SIZE = 256 * 2**10  # bytes before compression: what a reader decompresses to get one step


class DamagedLogError(UserError):
    """A checksum or the framing of a log does not hold. Steps read before this are right."""

    def __init__(self, path: Path, what: str) -> None:
        super().__init__(f"{path} is damaged: {what}")


def partial_path(path: Path) -> Path:
    """Where the log that will end up at `path` lies while it is being written."""
    return path.with_name(path.name + PARTIAL_SUFFIX)


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
