"""Every receiver of the bus, waiting for one message among many that it must refuse."""

import random
import tempfile
from collections.abc import Callable, Iterator, Mapping
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
from otc_dist.run.folder import RunFolder
from otc_dist.services.history import history_of
from otc_dist.services.process import Run
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions
from tests.bus.hostile import RUN, Target, hostile

DIGEST = "0123456789abcdef"
AGENT = AgentSpec("agent_0", 3, (-1.0, -2.0), (1.0, 2.0))
COPIES = {"deployment": 2, "evaluation": 4, "done": 0}
MOMENT = Moment("deployment", 4, 5, 6)
KEYS = Keys(RUN, "digest")
NEVER = 1e9  # seconds

Payloads = Iterator[bytes]
FLOATS = np.linspace(-1, 1, 14, dtype=np.float32)


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

    def ask_all(self, key: str, timeout: float) -> list[bytes]:
        return [next(self.feed)]


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
        msgpack.packb([*msgpack.unpackb(after)[:8], {"loss": float("nan")}, [], 0, 12]),
        msgpack.packb([*msgpack.unpackb(after)[:8], {str(i): 0.0 for i in range(300)}, [], 0, 12]),
        msgpack.packb([*msgpack.unpackb(after)[:7], float("inf"), {}, [], 0, 12]),
    )

    def same(place: int, odd: object) -> bool:
        text = place == 3 and type(odd) is str and len(odd) <= 256
        rate = place == 7 and type(odd) in (int, float) and odd == odd and abs(odd) != np.inf  # type: ignore[arg-type]
        start = place == 10 and type(odd) is int and odd >= 0
        return text or rate or start or (place, odd) in ((8, {}), (8, {"a": 1}), (9, []))

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
        asked = Run(root, description, team_spec("hopper-3x1"), KEYS, {}, False)
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
