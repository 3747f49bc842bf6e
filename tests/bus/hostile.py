"""Messages that a receiver must refuse, made from one that it would accept."""

import random
from collections.abc import Callable
from dataclasses import dataclass

import msgpack
import numpy as np

from otc_dist.bus.wire import PROTOCOL_VERSION

RUN = "run"
HUGE = 2**20  # bytes of the longest payloads; the session refuses more than the description allows


def repack(fields: list[object], wide: bool) -> bytes:
    """Fields as their sender packs them; `wide`: numbers and arrays of the lock-step's widths."""
    if not wide:
        packed: bytes = msgpack.packb(fields)
        return packed
    parts = [_wide(x) if place >= 4 else msgpack.packb(x) for place, x in enumerate(fields)]
    head = bytes([0x90 | len(parts)]) if len(parts) < 16 else b"\xdc\x00" + bytes([len(parts)])
    return head + b"".join(parts)


def _wide(value: object) -> bytes:
    if type(value) is int and 0 <= value < 2**32:
        return b"\xce" + value.to_bytes(4, "big")
    if type(value) is bytes:
        return b"\xc6" + len(value).to_bytes(4, "big") + value
    packed: bytes = msgpack.packb(value)
    return packed


ODD: tuple[object, ...] = (
    None, True, False, -1, 2**63, 2**64 - 1, -(2**63), 1.5, float("nan"), float("inf"), "",
    "x" * 300, "agent_1", b"", b"\x00" * 7, [], [1, [2, [3]]], {}, {"a": 1}, {1: 2},
    msgpack.ExtType(5, b"x"), msgpack.Timestamp(1, 1),
)  # fmt: skip
# Deep nesting, and lengths that nothing follows.
BOMBS = (b"\x91" * 5000, b"\xdd\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\x81")


@dataclass(frozen=True)
class Target:
    """A message, and what to make of it so that its receiver must refuse it.

    valid: what would be accepted. stale: what was accepted once, or is another's.
    arrays: the fields that hold float32, by their places.
    same: values that mean the same in a field as what stands there, or are right as well.
    """

    valid: bytes
    stale: tuple[bytes, ...]
    arrays: tuple[int, ...]
    same: Callable[[int, object], bool]
    wide: bool


def hostile(target: Target, noise: random.Random) -> bytes:
    """One payload that the receiver of `target` must refuse."""
    fields = msgpack.unpackb(target.valid)
    way = noise.randrange(12)
    if way == 0:
        return target.valid[: noise.randrange(1, len(target.valid))]
    if way == 1:
        return target.valid + noise.randbytes(noise.randrange(1, 20))
    if way == 2:
        return noise.randbytes(noise.randrange(1, 200))
    if way == 3:
        return noise.choice(target.stale)
    if way == 4:
        version = noise.choice((0, 1, PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1, 99, 2**40))
        return repack([version, *fields[1:]], target.wide)
    if way == 5:
        return repack(fields[: noise.randrange(len(fields))], target.wide)
    if way == 6:
        return repack([*fields, *[0] * noise.randrange(1, 4)], target.wide)
    if way == 7 and target.arrays:  # a number that is none
        place = noise.choice(target.arrays)
        array = bytearray(fields[place])
        at = 4 * noise.randrange(len(array) // 4) if place != 7 or not target.wide else 0
        bad = noise.choice((np.nan, np.inf, -np.inf))
        array[at : at + 4] = np.float32(bad).tobytes()
        return repack([*fields[:place], bytes(array), *fields[place + 1 :]], target.wide)
    if way == 8 and target.arrays:  # of another length
        place = noise.choice(target.arrays)
        other = fields[place] * noise.choice((2, 3)) + b"\x00" * noise.randrange(4)
        if noise.random() < 0.01:
            other = bytes(HUGE)
        return repack([*fields[:place], other, *fields[place + 1 :]], target.wide)
    if way == 9:
        return noise.choice(BOMBS) + noise.randbytes(3)
    if way == 10:  # the head, with a bit turned: a marker, the version, run or agent
        head = 1 + len(msgpack.packb(PROTOCOL_VERSION)) + len(msgpack.packb(RUN))
        at = noise.randrange(head)
        turned = target.valid[at] ^ (1 << noise.randrange(8))
        return target.valid[:at] + bytes([turned]) + target.valid[at + 1 :]
    while True:
        place = noise.randrange(len(fields))
        odd = noise.choice(ODD)
        if type(odd) is type(fields[place]) and odd == fields[place]:
            continue
        if not target.same(place, odd):
            return repack([*fields[:place], odd, *fields[place + 1 :]], target.wide)
