"""What arrives is either exactly what was expected, or rejected with a reason."""

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from otc_dist.bus.codec import AgentCodec
from otc_dist.bus.messages import (
    Action,
    Moment,
    Observation,
    Status,
    StepOutcome,
    decode_status,
    encode_status,
)
from otc_dist.bus.replies import (
    RunSpec,
    decode_history,
    decode_spec,
    encode_history,
    encode_spec,
    history_rows,
)
from otc_dist.bus.wire import PROTOCOL_VERSION, RejectedError
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Transitions

AGENT = AgentSpec("agent_0", 3, (-1.0, -2.0), (1.0, 2.0))
CODEC = AgentCodec("run", AGENT, {"deployment": 2, "evaluation": 4, "done": 0})
MOMENT = Moment("deployment", 1, 1, 5)
DIGEST = "0123456789abcdef"

_random = np.random.default_rng(0)


def _floats(*shape: int) -> np.ndarray:
    return _random.standard_normal(shape, dtype=np.float32)


def _observation(moment: Moment = MOMENT) -> Observation:
    copies = {"deployment": 2, "evaluation": 4, "done": 0}[moment.phase]
    if moment.phase == "done":
        return Observation(moment, None, None)
    outcome = StepOutcome(
        _floats(copies), _floats(copies, 3), np.array([True, False]), np.array([False, True])
    ) if moment.phase == "deployment" and moment.step else None  # fmt: skip
    return Observation(moment, _floats(copies, 3), outcome)


def _equal(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and np.array_equal(a, b)
    if isinstance(a, tuple) and isinstance(b, tuple):
        return type(a) is type(b) and all(_equal(x, y) for x, y in zip(a, b, strict=True))
    return a == b


OBSERVATION = CODEC.encode_observation(_observation())
ACTION = CODEC.encode_action(Action(MOMENT, _floats(2, 2), DIGEST))


@pytest.mark.parametrize(
    "moment",
    [
        Moment("deployment", 1, 1, 0),
        Moment("deployment", 3, 2, 7),
        Moment("evaluation", 0, 1, 9),
        Moment("done", 5, 1, 0),
    ],
)
def test_an_observation_survives_the_wire(moment: Moment) -> None:
    message = _observation(moment)
    assert _equal(CODEC.decode_observation(CODEC.encode_observation(message)), message)


def test_an_action_survives_the_wire() -> None:
    message = Action(MOMENT, _floats(2, 2), DIGEST)
    decoded = CODEC.decode_action(CODEC.encode_action(message), MOMENT, acting=True)
    assert _equal(decoded, message)
    empty = Action(MOMENT, None, DIGEST)
    assert CODEC.decode_action(CODEC.encode_action(empty), MOMENT, acting=False) == empty


def test_what_was_decoded_may_be_kept_and_written_to() -> None:
    message = CODEC.decode_observation(OBSERVATION)
    assert message.observations is not None and message.outcome is not None
    message.observations[:] = 0
    message.outcome.terminated[:] = False


def _changed(payload: bytes, field: int, value: object) -> bytes:
    """The message with another value in a field, otherwise laid out as the codec does."""
    fields = msgpack.unpackb(payload)
    fields[field] = value
    packed = [_wide(x) if i >= 4 else msgpack.packb(x) for i, x in enumerate(fields)]
    return bytes([0x90 + len(packed)]) + b"".join(packed)


def _wide(value: object) -> bytes:
    if type(value) is int and 0 <= value < 2**32:
        return b"\xce" + value.to_bytes(4, "big")
    if type(value) is bytes:
        return b"\xc6" + len(value).to_bytes(4, "big") + value
    return msgpack.packb(value)


ARRAYS = msgpack.unpackb(OBSERVATION)[7]  # 14 numbers and 4 booleans


def _with_number(place: int, value: float) -> bytes:
    arrays = bytearray(ARRAYS)
    arrays[4 * place : 4 * place + 4] = np.float32(value).tobytes()
    return bytes(arrays)


BAD_OBSERVATIONS = {
    "nothing": (b"", "malformed"),
    "no msgpack": (b"\xc1", "malformed"),
    "cut off": (OBSERVATION[:-1], "malformed"),
    "something after": (OBSERVATION + b"\x00", "malformed"),
    "deeply nested": (b"\x91" * 10_000 + b"\xc0", "malformed"),
    "a huge length": (b"\xdd\xff\xff\xff\xff", "malformed"),
    "no array": (msgpack.packb({"version": 1}), "malformed"),
    "an empty array": (b"\x90", "malformed"),
    "no version": (_changed(OBSERVATION, 0, "1"), "malformed"),
    "a boolean for a version": (_changed(OBSERVATION, 0, True), "malformed"),
    "another version": (_changed(OBSERVATION, 0, PROTOCOL_VERSION + 1), "version"),
    "too few fields": (msgpack.packb(msgpack.unpackb(OBSERVATION)[:-1]), "length"),
    "an action": (ACTION, "length"),
    "another run": (_changed(OBSERVATION, 1, "other"), "run"),
    "another agent": (_changed(OBSERVATION, 2, "agent_1"), "agent"),
    "an unknown phase": (_changed(OBSERVATION, 3, 3), "phase"),
    "a phase that is text": (_changed(OBSERVATION, 3, "deployment"), "type"),
    "a phase of other copies": (_changed(OBSERVATION, 3, 1), "shape"),
    "numbers when all is done": (_changed(OBSERVATION, 3, 2), "shape"),
    "a negative deployment": (_changed(OBSERVATION, 4, -1), "type"),
    "a boolean epoch": (_changed(OBSERVATION, 5, True), "type"),
    "a huge step": (_changed(OBSERVATION, 6, 2**64 - 1), "type"),
    "a fractional step": (_changed(OBSERVATION, 6, 1.5), "type"),
    "text for numbers": (_changed(OBSERVATION, 7, "x" * 60), "type"),
    "numbers of another width": (msgpack.packb(msgpack.unpackb(OBSERVATION)), "malformed"),
    "too few numbers": (_changed(OBSERVATION, 7, ARRAYS[:-1]), "shape"),
    "a byte too many": (_changed(OBSERVATION, 7, ARRAYS + b"\x00"), "shape"),
    "NaN": (_changed(OBSERVATION, 7, _with_number(0, np.nan)), "not-finite"),
    "infinity": (_changed(OBSERVATION, 7, _with_number(13, np.inf)), "not-finite"),
    "a boolean of 2": (_changed(OBSERVATION, 7, ARRAYS[:-1] + b"\x02"), "type"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD_OBSERVATIONS)
def test_a_bad_observation_is_rejected_with_its_reason(name: str) -> None:
    payload, reason = BAD_OBSERVATIONS[name]
    with pytest.raises(RejectedError) as rejected:
        CODEC.decode_observation(payload)
    assert rejected.value.reason == reason


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (CODEC.encode_action(Action(MOMENT._replace(epoch=2), _floats(2, 2), DIGEST)), "epoch"),
        (CODEC.encode_action(Action(MOMENT._replace(step=4), _floats(2, 2), DIGEST)), "stale"),
        (
            CODEC.encode_action(Action(MOMENT._replace(deployment=2), _floats(2, 2), DIGEST)),
            "stale",
        ),
        (CODEC.encode_action(Action(MOMENT, None, DIGEST)), "shape"),
        (CODEC.encode_action(Action(MOMENT, _floats(2, 1), DIGEST)), "shape"),
        (_changed(ACTION, 8, "short"), "policy"),
        (_changed(ACTION, 8, "0123456789abcde-"), "policy"),
        (_changed(ACTION, 8, 16), "type"),
        (ACTION[:-17] + b"\xaf" + ACTION[-16:], "policy"),
        (CODEC.encode_action(Action(MOMENT, _floats(2, 2) * np.nan, DIGEST)), "not-finite"),
        (OBSERVATION, "length"),
    ],
)
def test_a_bad_action_is_rejected_with_its_reason(payload: bytes, reason: str) -> None:
    with pytest.raises(RejectedError) as rejected:
        CODEC.decode_action(payload, MOMENT, acting=True)
    assert rejected.value.reason == reason


def test_an_action_where_none_is_asked_is_rejected() -> None:
    with pytest.raises(RejectedError):
        CODEC.decode_action(ACTION, MOMENT, acting=False)


def test_another_protocol_version_is_refused_in_one_sentence_that_names_both() -> None:
    with pytest.raises(RejectedError, match=rf"version 7 and this one {PROTOCOL_VERSION}: install"):
        CODEC.decode_observation(msgpack.packb([7, "what", {"ever": "follows"}]))


@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=200))
def test_no_bytes_are_accepted_or_raise_anything_else(payload: bytes) -> None:
    for decode in (
        CODEC.decode_observation,
        lambda p: CODEC.decode_action(p, MOMENT, acting=True),
        lambda p: decode_status(p, "run", "agent_0"),
        lambda p: decode_spec(p, "run"),
        lambda p: decode_history(p, "run", AGENT, 1, 0),
    ):
        with pytest.raises(RejectedError):
            decode(payload)


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text()
    | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=5,
)  # fmt: skip


@settings(max_examples=500, deadline=None)
@given(field=st.integers(0, 7), value=_VALUES)
def test_a_changed_field_is_rejected_or_means_what_it_says(field: int, value: object) -> None:
    """Whatever stands in a field, decoding ends in a message that encodes to the same bytes."""
    payload = _changed(OBSERVATION, field, value)
    try:
        message = CODEC.decode_observation(payload)
    except RejectedError:
        return
    assert CODEC.encode_observation(message) == payload


def test_a_status_survives_the_wire_without_what_is_not_finite() -> None:
    status = Status("host", "deployment", 2, 30, 100, 12.5, {"return": 3.0, "loss": float("nan")})
    decoded = decode_status(encode_status("run", status), "run", "host")
    assert decoded.metrics == {"return": 3.0}
    assert (decoded.phase, decoded.deployment, decoded.update, decoded.total, decoded.rate) == (
        "deployment", 2, 30, 100, 12.5,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        (2, "agent_1", "agent"),
        (3, 5, "type"),
        (3, "x" * 300, "type"),
        (3, "tuning\x1b[2J", "type"),
        (8, {"loss\n": 0.0}, "type"),
        (5, -1, "type"),
        (7, float("inf"), "not-finite"),
        (8, [], "type"),
        (8, {"a": "b"}, "type"),
        (8, {str(i): 0.0 for i in range(1000)}, "type"),
    ],
)
def test_a_bad_status_is_rejected(field: int, value: object, reason: str) -> None:
    payload = _changed(encode_status("run", Status("agent_0")), field, value)
    with pytest.raises(RejectedError) as rejected:
        decode_status(payload, "run", "agent_0")
    assert rejected.value.reason == reason


def test_the_spec_survives_the_wire() -> None:
    spec = RunSpec("hopper-3x1", (AGENT, AgentSpec("agent_1", 4, (0.0,), (2.0,), 3)), DIGEST)
    assert decode_spec(encode_spec("run", spec), "run") == spec


@pytest.mark.parametrize("names", [("../x", "b"), ("a", "a"), ("host", "b"), ("a", "\u202e")])
def test_a_spec_with_names_that_will_not_do_is_rejected(names: tuple[str, str]) -> None:
    agents = tuple(AgentSpec(name, 4, (0.0,), (2.0,), 3) for name in names)
    with pytest.raises(RejectedError) as rejected:
        decode_spec(encode_spec("run", RunSpec("hopper-3x1", agents, DIGEST)), "run")
    assert rejected.value.reason in ("name", "type")
    with pytest.raises(RejectedError):
        decode_spec(encode_spec("run", RunSpec("../x", (AGENT,), DIGEST)), "run")


def _history(rows: int) -> Transitions:
    ends = np.zeros(rows, np.bool_)
    return Transitions(
        _floats(rows, 3), _floats(rows, 2), _floats(rows), _floats(rows, 3), ends, ends
    )


def test_a_history_page_survives_the_wire_and_fits_the_payload() -> None:
    rows = history_rows(AGENT, 10_000)
    payload = encode_history("run", "agent_0", 3, 40, _history(rows))
    assert len(payload) <= 10_000
    assert len(decode_history(payload, "run", AGENT, 3, 40)) == rows
    with pytest.raises(RejectedError):
        decode_history(payload, "run", AGENT, 3, 41)
    with pytest.raises(RejectedError):
        decode_history(payload, "run", AgentSpec("agent_1", 3, (0.0,) * 2, (1.0,) * 2), 3, 40)
