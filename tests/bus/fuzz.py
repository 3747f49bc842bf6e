"""Throws hostile and broken messages at every receiver of the bus.

    python -m tests.bus.fuzz [--count 1000000] [--seed 0]

Each receiver is the real one, behind a session that hands it what the fuzzer makes: wrong lengths,
types, runs, agents, versions, epochs, moments, NaN, infinities, huge numbers and arrays, msgpack
bombs, noise, and messages that were right a moment ago. None of them is what the receiver waits
for, so each must be rejected, with a reason; at the end comes the right message, which must be
taken. Prints, for each receiver, the payloads by reason, payloads a second, and how much memory
the process grew over the last nine tenths.
"""

import argparse
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgpack
import numpy as np

from otc_dist.bus import handshake, history
from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.keys import Keys
from otc_dist.bus.lockstep import HostLockstep, LearnerLockstep
from otc_dist.bus.messages import Action, Moment, Observation, Status, StepOutcome, encode_status
from otc_dist.bus.replies import RunSpec, encode_history, encode_spec
from otc_dist.bus.status import StatusBoard
from otc_dist.bus.wire import PROTOCOL_VERSION, Rejections
from otc_dist.description import Description
from otc_dist.envs.registry import team_spec
from otc_dist.run_folder import RunFolder
from otc_dist.services.history import history_of
from otc_dist.services.process import Run
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

RUN, DIGEST = "run", "0123456789abcdef"
AGENT = AgentSpec("agent_0", 3, (-1.0, -2.0), (1.0, 2.0))
COPIES = {"deployment": 2, "evaluation": 4, "done": 0}
MOMENT = Moment("deployment", 4, 5, 6)
KEYS = Keys(RUN)
HUGE = 2**20  # bytes of the longest payloads; the session refuses more than the description allows
NEVER = 1e9  # seconds

Payloads = Iterator[bytes]
FLOATS = np.linspace(-1, 1, 14, dtype=np.float32)


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


def hostile(target: Target, random: random.Random) -> bytes:
    """One payload that the receiver of `target` must refuse."""
    fields = msgpack.unpackb(target.valid)
    way = random.randrange(12)
    if way == 0:
        return target.valid[: random.randrange(1, len(target.valid))]
    if way == 1:
        return target.valid + random.randbytes(random.randrange(1, 20))
    if way == 2:
        return random.randbytes(random.randrange(1, 200))
    if way == 3:
        return random.choice(target.stale)
    if way == 4:
        version = random.choice((0, 1, PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1, 99, 2**40))
        return repack([version, *fields[1:]], target.wide)
    if way == 5:
        return repack(fields[: random.randrange(len(fields))], target.wide)
    if way == 6:
        return repack([*fields, *[0] * random.randrange(1, 4)], target.wide)
    if way == 7 and target.arrays:  # a number that is none
        place = random.choice(target.arrays)
        array = bytearray(fields[place])
        at = 4 * random.randrange(len(array) // 4) if place != 7 or not target.wide else 0
        bad = random.choice((np.nan, np.inf, -np.inf))
        array[at : at + 4] = np.float32(bad).tobytes()
        return repack([*fields[:place], bytes(array), *fields[place + 1 :]], target.wide)
    if way == 8 and target.arrays:  # of another length
        place = random.choice(target.arrays)
        other = fields[place] * random.choice((2, 3)) + b"\x00" * random.randrange(4)
        if random.random() < 0.01:
            other = bytes(HUGE)
        return repack([*fields[:place], other, *fields[place + 1 :]], target.wide)
    if way == 9:
        return random.choice(BOMBS) + random.randbytes(3)
    if way == 10:  # the head, with a bit turned: a marker, the version, run or agent
        head = 1 + len(msgpack.packb(PROTOCOL_VERSION)) + len(msgpack.packb(RUN))
        at = random.randrange(head)
        turned = target.valid[at] ^ (1 << random.randrange(8))
        return target.valid[:at] + bytes([turned]) + target.valid[at + 1 :]
    while True:
        place = random.randrange(len(fields))
        odd = random.choice(ODD)
        if type(odd) is type(fields[place]) and odd == fields[place]:
            continue
        if not target.same(place, odd):
            return repack([*fields[:place], odd, *fields[place + 1 :]], target.wide)


class Wire:
    """A session without a bus: receivers are given what `feed` holds, and nothing is sent."""

    def __init__(self) -> None:
        self.feed: Payloads = iter(())
        self.receivers: dict[str, Callable[[bytes], None]] = {}

    def publisher(self, key: str) -> Callable[[bytes], None]:
        return lambda payload: None

    def subscribe(self, key: str, receive: Callable[[bytes], None]) -> None:
        self.receivers[key] = receive

    def inbox(self, key: str) -> "Wire":
        return self

    def get(self, until: float) -> bytes | None:
        return next(self.feed, None)

    def look(self) -> bytes | None:
        return next(self.feed, None)

    def ask(self, key: str, parameters: Mapping[str, str], timeout: float) -> bytes | None:
        return next(self.feed, None)


def _then(count: int, make: Callable[[], bytes], last: bytes) -> Payloads:
    for _ in range(count):
        yield make()
    yield last


def _observation(moment: Moment) -> Observation:
    ends = np.zeros(2, np.bool_)
    outcome = StepOutcome(FLOATS[:2], FLOATS[:6].reshape(2, 3), ends, ends)
    return Observation(moment, FLOATS[:6].reshape(2, 3), outcome)


def _earlier(moment: Moment) -> tuple[Moment, ...]:
    return (
        moment._replace(epoch=moment.epoch - 1),
        moment._replace(step=moment.step - 1),
        moment._replace(deployment=moment.deployment - 1),
    )


def _other_kind(place: int, odd: object, *kinds: tuple[int, type]) -> bool:
    """Whether a field of one of `kinds` (place, type) would hold a value of its own type."""
    return any(place == at and type(odd) is kind for at, kind in kinds)


def host_action(count: int, rejections: Rejections, noise: random.Random) -> None:
    """The env host waits for an answer."""
    wire, codec = Wire(), AgentCodec(RUN, AGENT, COPIES)
    side = HostLockstep(wire, KEYS, [AGENT], COPIES, NEVER, rejections)  # type: ignore[arg-type]

    def answer(moment: Moment, run: str = RUN, agent: AgentSpec = AGENT) -> bytes:
        action = Action(moment, FLOATS[:4].reshape(2, 2), DIGEST)
        return AgentCodec(run, agent, COPIES).encode_action(action)

    late = (MOMENT._replace(epoch=6), MOMENT._replace(step=7), MOMENT._replace(phase="evaluation"))
    other = AgentSpec("agent_1", 3, (-1.0, -2.0), (1.0, 2.0))
    stale = (
        *map(answer, (*_earlier(MOMENT), *late)),
        answer(MOMENT, agent=other),
        answer(MOMENT, "another"),
        codec.encode_observation(_observation(MOMENT)),
    )
    target = Target(answer(MOMENT), stale, (7,), lambda place, odd: False, wide=True)
    wire.feed = _then(count, lambda: hostile(target, noise), target.valid)
    (taken,) = side.ask([_observation(MOMENT)], acting=True)
    assert codec.encode_action(taken) == target.valid


def learner_observation(count: int, rejections: Rejections, noise: random.Random) -> None:
    """A learner waits for a question."""
    wire, codec = Wire(), AgentCodec(RUN, AGENT, COPIES)
    side = LearnerLockstep(wire, KEYS, AGENT, COPIES, rejections)  # type: ignore[arg-type]
    wire.feed = iter([codec.encode_observation(_observation(MOMENT))])
    assert side.question(0.0) is not None
    now = MOMENT._replace(step=7)

    def question(moment: Moment, run: str = RUN, agent: str = "agent_0") -> bytes:
        spec = AgentSpec(agent, 3, (-1.0, -2.0), (1.0, 2.0))
        return AgentCodec(run, spec, COPIES).encode_observation(_observation(moment))

    action = codec.encode_action(Action(MOMENT, FLOATS[:4].reshape(2, 2), DIGEST))
    stale = (
        *map(question, _earlier(MOMENT)),
        question(now, "another"),
        question(now, agent="agent_1"),
        action,
    )
    target = Target(question(now), stale, (7,), lambda place, odd: False, wide=True)
    wire.feed = _then(count, lambda: hostile(target, noise), target.valid)
    taken = side.question(0.0)
    assert taken is not None and codec.encode_observation(taken) == target.valid


def status(count: int, rejections: Rejections, noise: random.Random) -> None:
    """The env host, the learners and the launcher hear statuses."""
    wire = Wire()
    board = StatusBoard(wire, KEYS, ("agent_0",), rejections)  # type: ignore[arg-type]
    receive = wire.receivers[KEYS.status("agent_0")]
    first = Status("agent_0", "offline", 0, 1, 2, 3.0, {"loss": 1.0}, beat=10)
    receive(encode_status(RUN, first))
    after = encode_status(RUN, Status("agent_0", "tuning", 1, 1, 2, 3.0, {"loss": 1.0}, beat=11))
    stale = (
        encode_status(RUN, first),
        encode_status(RUN, Status("agent_1", beat=12)),
        encode_status("another", Status("agent_0", beat=12)),
        msgpack.packb([*msgpack.unpackb(after)[:8], {"loss": float("nan")}, 12]),
        msgpack.packb([*msgpack.unpackb(after)[:8], {str(i): 0.0 for i in range(300)}, 12]),
        msgpack.packb([*msgpack.unpackb(after)[:7], float("inf"), {}, 12]),
    )

    def same(place: int, odd: object) -> bool:
        text = place == 3 and type(odd) is str and len(odd) <= 256
        rate = place == 7 and type(odd) in (int, float) and odd == odd and abs(odd) != np.inf  # type: ignore[arg-type]
        return text or rate or (place == 8 and odd in ({}, {"a": 1}))

    target = Target(after, stale, (), same, wide=False)
    for payload in _then(count, lambda: hostile(target, noise), after):
        receive(payload)
        if payload is not after:
            assert board.newest("agent_0") == first, payload
    newest = board.newest("agent_0")
    assert newest is not None and newest.beat == 11


def spec_reply(count: int, rejections: Rejections, noise: random.Random) -> None:
    """A learner asks for the run's spec."""
    wire, mine = Wire(), RunSpec("env", (AGENT,), DIGEST)
    valid = encode_spec(RUN, mine)
    fields = msgpack.unpackb(valid)

    def with_agent(*agent: object) -> bytes:
        packed: bytes = msgpack.packb([*fields[:3], [list(agent)], fields[4]])
        return packed

    stale = (
        encode_spec("another", mine),
        with_agent("agent_0", 3, [float("nan"), 0.0], [1.0, 1.0], 0),
        with_agent("agent_0", 3, [0.0], [1.0, 1.0], 0),
        with_agent("agent_0", -3, [0.0], [1.0], 0),
        with_agent("agent_0", 3, [0.0], [1.0], "0"),
        with_agent("agent_0", 3),
    )

    def same(place: int, odd: object) -> bool:
        return (place in (2, 4) and type(odd) is str and len(odd) <= 256) or (place, odd) == (3, [])

    target = Target(valid, stale, (), same, wide=False)

    def refused_but_version() -> bytes:
        """Another version ends the learner with one sentence; that is tested elsewhere."""
        while True:
            payload = hostile(target, noise)
            try:
                version = msgpack.unpackb(payload)[0]
            except Exception:
                return payload
            if type(version) is not int or version == PROTOCOL_VERSION:
                return payload

    wire.feed = _then(count, refused_but_version, valid)
    handshake.agree(wire, KEYS, mine, NEVER, rejections)  # type: ignore[arg-type]


def history_page(count: int, rejections: Rejections, noise: random.Random) -> None:
    """A learner asks for its own past."""
    wire, ends = Wire(), np.zeros(2, np.bool_)
    rows = FLOATS[:6].reshape(2, 3)
    page = Transitions(rows, FLOATS[:4].reshape(2, 2), FLOATS[:2], rows, ends, ends)
    valid = encode_history(RUN, "agent_0", 4, 6, page)
    stale = (
        encode_history(RUN, "agent_0", 4, 5, page),
        encode_history(RUN, "agent_0", 3, 6, page),
        encode_history(RUN, "agent_1", 4, 6, page),
        encode_history("another", "agent_0", 4, 6, page),
        encode_history(RUN, "agent_0", 4, 6, page[:1]),  # half a step
        encode_history(RUN, "agent_0", 4, 6, Transitions.concatenate([page, page])),  # too many
    )
    target = Target(valid, stale, (6, 7, 8, 9), lambda place, odd: False, wide=False)
    wire.feed = _then(count, lambda: hostile(target, noise), valid)
    asked = history.History(wire, KEYS, AGENT, 2, NEVER, rejections)  # type: ignore[arg-type]
    assert len(asked.fetch(4, 6, 7)) == 2


def history_query(count: int, rejections: Rejections, noise: random.Random) -> None:
    """The env host is asked for an agent's past: here by parameters, which are text."""
    description = Description.build(
        {"name": "fuzz", "env": {"id": "hopper-3x1"}, "dataset": {"name": "hopper-3x1/random"}},
        ["deployment.transitions=80"],
    )
    with tempfile.TemporaryDirectory() as folder:
        root = RunFolder(Path(folder))
        asked = Run(root, description, team_spec("hopper-3x1"), KEYS)
        reply = history_of(asked, "agent_0", rejections)
        right = {"deployment": "1", "start": "0", "stop": "5"}
        bad = (
            *(
                "",
                "-1",
                "1.5",
                "nan",
                "inf",
                "1e3",
                "0x1",
                " 1",
                "1_0",
                "\u0661",
                "\u00b2",
                "9" * 5000,
            ),
            *("../../etc", "\x00", "[1]", "None", "1;stop=2"),
        )
        for _ in range(count):
            parameters = dict(right)
            name = noise.choice(tuple(right))
            way = noise.randrange(4)
            if way == 0:
                del parameters[name]
            elif way == 1:
                parameters |= noise.choice(({"deployment": "0"}, {"deployment": "999"}))
            elif way == 2:
                parameters |= noise.choice(({"start": "5"}, {"start": "9", "stop": "7"}))
            else:
                parameters[name] = noise.choice(bad)
            try:
                reply(parameters)
            except LookupError:
                continue
            raise AssertionError(f"{parameters} was answered")


RECEIVERS: dict[str, Callable[[int, Rejections, random.Random], None]] = {
    "host: action": host_action,
    "learner: observation": learner_observation,
    "all: status": status,
    "learner: spec": spec_reply,
    "learner: history": history_page,
    "host: history query": history_query,
}


def resident() -> int:
    """Bytes of memory that this process holds."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE")


def run(name: str, count: int, seed: int) -> tuple[dict[str, int], int]:
    """Payloads by reason, and the bytes by which memory grew over the last nine tenths."""
    rejections, noise = Rejections(), random.Random(seed)
    first = count // 10
    RECEIVERS[name](first, rejections, noise)
    before = resident()
    RECEIVERS[name](count - first, rejections, noise)
    grown = resident() - before
    counts = rejections.as_metrics()
    return {key.removeprefix("rejected/"): int(n) for key, n in counts.items()}, grown


def quick_retries() -> None:
    """Ask again at once after a message that was refused."""
    handshake._RETRY = history._RETRY = 0.0


def main() -> int:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("--count", type=int, default=1_000_000, help="payloads at each receiver")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    quick_retries()
    wrong = 0
    for name in RECEIVERS:
        start = time.monotonic()
        counts, grown = run(name, arguments.count, arguments.seed)
        rate = arguments.count / (time.monotonic() - start)
        total = sum(counts.values())
        wrong += total != arguments.count
        by_reason = ", ".join(f"{reason} {n:,}" for reason, n in counts.items())
        print(
            f"{name:21} {arguments.count:,} sent, {total:,} rejected, {rate:,.0f}/s,"
            f" memory {grown / 2**20:+.1f} MiB: {by_reason}",
            flush=True,
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
