"""Names, versions and limits of the deployment log, and the checksum of its metadata.

A log is an MCAP file (https://mcap.dev/spec). Whatever lies in it is covered by a checksum:
steps by one inside each record, metadata by one inside each map, chunks and the summary by MCAP.
"""

import zlib
from collections.abc import Mapping
from pathlib import Path

from otc_dist.errors import UserError

FORMAT_VERSION = 1
MINIMUM_FORMAT_VERSION = 1  # the oldest version that this code still reads

PROFILE = "x-otc-dist"
TOPIC = "joint_step"
SCHEMA = "otc_dist.JointStep"
HEADER = "otc_dist.header"
POLICIES = "otc_dist.policies"
EPISODES = "otc_dist.episodes"
RANGES = "otc_dist.ranges"  # only where steps are missing

PARTIAL_SUFFIX = ".partial"
MAXIMUM_RECORD = 64 * 2**20  # bytes of one record; a larger length is damage, not data
CHUNK_SIZE = 256 * 2**10  # bytes before compression: what a reader decompresses to get one step


class DamagedLogError(UserError):
    """A checksum or the framing of a log does not hold. Steps read before this are right."""

    def __init__(self, path: Path, what: str) -> None:
        super().__init__(f"{path} is damaged: {what}")


def partial_path(path: Path) -> Path:
    """Where the log that will end up at `path` lies while it is being written."""
    return path.with_name(path.name + PARTIAL_SUFFIX)


def seal(entries: Mapping[str, str]) -> dict[str, str]:
    """`entries` with their checksum under the key "crc32"."""
    return {**entries, "crc32": _checksum(entries)}


def unseal(entries: Mapping[str, str]) -> dict[str, str] | None:
    """What was sealed, or None if a byte of it has changed."""
    opened = dict(entries)
    checksum = opened.pop("crc32", None)
    return opened if checksum == _checksum(opened) else None


def _checksum(entries: Mapping[str, str]) -> str:
    # Two NULs end every string: neither keys nor values can move from one to the other unseen.
    text = "".join(f"{key}\0\0{entries[key]}\0\0" for key in sorted(entries))
    return f"{zlib.crc32(text.encode()):08x}"
