"""The codec's ground: msgpack arrays of fixed fields, checked against what is expected.

What arrives is not trusted. Whatever does not match raises `RejectedError`; receivers count the
reasons (`Rejections`) and go on.
"""

import logging
import math
import threading
from collections import Counter
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

from otc_dist.transitions import Bool, Float32, all_finite

log = logging.getLogger(__name__)

PROTOCOL_VERSION = 4
_LONGEST_NAME = 256  # characters
FLOAT, BOOLEAN = np.dtype("<f4"), np.dtype("?")


class RejectedError(Exception):
    """A message that is not accepted. `reason` is a short word to count by."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(detail or reason)
        self.reason = reason


class Rejections:
    """How many messages were rejected, by reason. Counting is safe from any thread."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()

    def count(self, rejected: RejectedError) -> None:
        with self._lock:
            self._counts[rejected.reason] += 1
            first = self._counts[rejected.reason] == 1
        if first and str(rejected) != rejected.reason:  # it is described in more than a word
            log.warning("rejected a message: %s", rejected)

    def __getitem__(self, reason: str) -> int:
        return self._counts[reason]

    def by_reason(self) -> dict[str, int]:
        """The counts."""
        with self._lock:
            return dict(sorted(self._counts.items()))

    def as_metrics(self) -> dict[str, float]:
        """The counts as metrics of a status: `rejected/{reason}`."""
        return {f"rejected/{reason}": float(n) for reason, n in self.by_reason().items()}


def pack(fields: list[object]) -> bytes:
    """Encode fixed fields; the first is always the protocol version, the second the run."""
    packed: bytes = msgpack.packb(fields)
    return packed


def version_mismatch(theirs: object) -> str:
    """The one sentence that refuses a process of another protocol version."""
    return (
        f"the other process speaks protocol version {theirs} and this one {PROTOCOL_VERSION}:"
        " install the same version of otc_dist on both"
    )


def unpack(payload: bytes, run: str, count: int) -> list[Any]:
    """Decode `count` fields, version and run included.

    Raises:
        RejectedError: malformed, version, length (of the array) or run.
    """
    try:
        fields = msgpack.unpackb(payload)
    except Exception:  # msgpack raises a dozen kinds, and none of them may end a process
        raise RejectedError("malformed") from None
    if type(fields) is not list or not fields or type(fields[0]) is not int:
        raise RejectedError("malformed")
    # The version goes first: another version may have other fields.
    if fields[0] != PROTOCOL_VERSION:
        raise RejectedError("version", version_mismatch(fields[0]))
    if len(fields) != count:
        raise RejectedError("length")
    if fields[1] != run:
        raise RejectedError("run")
    return fields


def natural(value: object) -> int:
    """A count, 0 .. 2^63 - 1."""
    if type(value) is not int or not 0 <= value < 2**63:
        raise RejectedError("type")
    return value


def name(value: object) -> str:
    """A string of at most 256 characters, all of which can be seen: it is shown to people."""
    if type(value) is not str or len(value) > _LONGEST_NAME or not value.isprintable():
        raise RejectedError("type")
    return value


def number(value: object) -> float:
    """A finite number."""
    if type(value) is not float and type(value) is not int:
        raise RejectedError("type")
    try:
        result = float(value)
    except OverflowError:
        raise RejectedError("not-finite") from None
    if not math.isfinite(result):
        raise RejectedError("not-finite")
    return result


def raw(array: NDArray[Any], kind: np.dtype[Any] = FLOAT) -> bytes:
    """The bytes of an array of this type, little-endian, in C order."""
    if array.dtype != kind:
        raise TypeError(f"the array should hold {kind}, not {array.dtype}")
    return array.tobytes()


def check_booleans(value: bytes) -> None:
    """Raises RejectedError unless all bytes are 0 or 1."""
    if value.strip(b"\x00\x01"):  # what is left holds a byte that is neither
        raise RejectedError("type")


def floats(value: object, *shape: int) -> Float32:
    """Finite float32 of exactly `shape`. The array is the caller's own, to keep and to write."""
    if type(value) is not bytes:
        raise RejectedError("type")
    if len(value) != 4 * math.prod(shape):
        raise RejectedError("shape")
    flat = np.frombuffer(bytearray(value), FLOAT)  # a copy, to be writable
    if not all_finite(flat):
        raise RejectedError("not-finite")
    return flat.reshape(shape)


def booleans(value: object, size: int) -> Bool:
    """Exactly `size` booleans, one byte each."""
    if type(value) is not bytes:
        raise RejectedError("type")
    if len(value) != size:
        raise RejectedError("shape")
    check_booleans(value)
    return np.frombuffer(bytearray(value), BOOLEAN)
