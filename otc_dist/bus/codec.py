"""The codec of the lock-step: an agent's questions and answers, as bytes whose places are fixed.

    question  [version, run, agent, phase, deployment, epoch, step, arrays]
    answer    [version, run, agent, phase, deployment, epoch, step, actions, policy]

A message is a msgpack array, with numbers and lengths always as wide, so every field has its
place. What is right is recognised by comparing bytes; only what is not is unpacked, to say
what is wrong with it. This happens eight times a lock-step, mostly in processes that have just
been woken, with cold caches: few operations count.
"""

import struct
from collections.abc import Mapping

import msgpack
import numpy as np

from otc_dist.bus.messages import PHASES, Action, Moment, Observation, StepOutcome
from otc_dist.bus.wire import (
    BOOLEAN,
    FLOAT,
    PROTOCOL_VERSION,
    RejectedError,
    check_booleans,
    name,
    natural,
    raw,
    unpack,
)
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Float32, all_finite

POLICY_DIGEST_LENGTH = 16
_QUESTION, _ANSWER = 8, 9  # fields

# deployment, epoch, step and the arrays' length, each after its marker
_NUMBERS = struct.Struct(">BIBIBIBI")
_UINT32, _BINARY = 0xCE, 0xC6
_DIGEST = bytes([0xA0 | POLICY_DIGEST_LENGTH])  # marker of a text of this length
_TAIL = len(_DIGEST) + POLICY_DIGEST_LENGTH


class AgentCodec:
    """Encodes and decodes the lock-step messages of one agent in one run.

    Args:
        run: the run's name.
        agent: the agent's sizes.
        copies: E, by phase.

    The decoders raise RejectedError for anything that does not match, exactly.
    """

    def __init__(self, run: str, agent: AgentSpec, copies: Mapping[str, int]) -> None:
        self._question = _Frame(run, agent.name, _QUESTION, 0)
        self._answer = _Frame(run, agent.name, _ANSWER, _TAIL)
        self._seen = {phase: (count, agent.observation_size) for phase, count in copies.items()}
        self._acted = {phase: (count, agent.action_size) for phase, count in copies.items()}

    def encode_observation(self, message: Observation) -> bytes:
        moment, observations, outcome = message
        if observations is None:
            return self._question.encode(moment, b"")
        body = raw(observations)
        if outcome is not None:
            rewards, next_observations, terminated, truncated = outcome
            body += raw(rewards) + raw(next_observations)
            body += raw(terminated, BOOLEAN) + raw(truncated, BOOLEAN)
        return self._question.encode(moment, body)

    def decode_observation(self, payload: bytes) -> Observation:
        moment, body = self._question.decode(payload)
        if moment.phase == "done":
            if body:
                raise RejectedError("shape")
            return Observation(moment, None, None)
        shape = self._seen[moment.phase]
        if moment.phase == "evaluation" or moment.step == 0:
            return Observation(moment, _floats(body, shape), None)
        copies, size = shape
        numbers = copies * (2 * size + 1)
        ends = 4 * numbers  # where the floats end
        if len(body) != ends + 2 * copies:
            raise RejectedError("shape")
        data, array = bytearray(body), np.ndarray  # its constructor is the quickest way
        if not all_finite(array((numbers,), FLOAT, data)):
            raise RejectedError("not-finite")
        check_booleans(body[ends:])
        rewards = 4 * copies * size
        outcome = StepOutcome(
            array((copies,), FLOAT, data, rewards),
            array(shape, FLOAT, data, rewards + 4 * copies),
            array((copies,), BOOLEAN, data, ends),
            array((copies,), BOOLEAN, data, ends + copies),
        )
        return Observation(moment, array(shape, FLOAT, data), outcome)

    def encode_action(self, message: Action) -> bytes:
        moment, actions, policy = message
        if len(policy) != POLICY_DIGEST_LENGTH:
            raise ValueError(f"{policy!r} is not a policy digest")
        body = b"" if actions is None else raw(actions)
        return self._answer.encode(moment, body) + _DIGEST + policy.encode()

    def decode_action(self, payload: bytes, asked: Moment, *, acting: bool) -> Action:
        """`asked`: the moment that must be answered; `acting`: with an action, or with none."""
        moment, body = self._answer.decode(payload)
        if moment != asked:
            raise RejectedError("epoch" if moment.epoch != asked.epoch else "stale")
        policy = payload[-POLICY_DIGEST_LENGTH:]
        if payload[-_TAIL] != _DIGEST[0] or not policy.isalnum():
            raise RejectedError("policy")
        if not acting and body:
            raise RejectedError("shape")
        actions = _floats(body, self._acted[moment.phase]) if acting else None
        return Action(moment, actions, policy.decode())


class _Frame:
    """The fields that all messages of one kind begin with, up to the arrays.

    Args:
        count: of all fields.
        tail: bytes after the arrays.
    """

    def __init__(self, run: str, agent: str, count: int, tail: int) -> None:
        self._run, self._agent, self._count, self._tail = run, agent, count, tail
        start = bytes([0x90 | count])  # marker of an array
        start += b"".join(map(msgpack.packb, (PROTOCOL_VERSION, run, agent)))
        self._heads = {phase: start + bytes([number]) for phase, number in PHASES.items()}
        self._phases = {head: phase for phase, head in self._heads.items()}
        self._numbers = len(start) + 1
        self._body = self._numbers + _NUMBERS.size

    def encode(self, moment: Moment, body: bytes) -> bytes:
        phase, deployment, epoch, step = moment
        numbers = (_UINT32, deployment, _UINT32, epoch, _UINT32, step, _BINARY, len(body))
        return self._heads[phase] + _NUMBERS.pack(*numbers) + body

    def decode(self, payload: bytes) -> tuple[Moment, bytes]:
        """The moment, and the arrays' bytes."""
        phase = self._phases.get(payload[: self._numbers])
        end = len(payload) - self._tail
        if phase is not None and end >= self._body:
            first, deployment, second, epoch, third, step, fourth, size = _NUMBERS.unpack_from(
                payload, self._numbers
            )
            markers_fit = first == second == third == _UINT32 and fourth == _BINARY
            if markers_fit and size == end - self._body:
                return Moment(phase, deployment, epoch, step), payload[self._body : end]
        raise self._wrong(payload)

    def _wrong(self, payload: bytes) -> RejectedError:
        """Why a message is not laid out as it must be."""
        try:
            fields = unpack(payload, self._run, self._count)
            if fields[2] != self._agent:
                return RejectedError("agent")
            if natural(fields[3]) not in PHASES.values():
                return RejectedError("phase")
            for field in fields[4:7]:
                natural(field)
            if type(fields[7]) is not bytes:
                return RejectedError("type")
            if self._tail and len(name(fields[8])) != POLICY_DIGEST_LENGTH:
                return RejectedError("policy")
        except RejectedError as rejected:
            return rejected
        return RejectedError("malformed")


def _floats(body: bytes, shape: tuple[int, int]) -> Float32:
    """Finite float32 of exactly `shape`. The array is the caller's own, to keep and to write."""
    if len(body) != 4 * shape[0] * shape[1]:
        raise RejectedError("shape")
    array: Float32 = np.ndarray(shape, FLOAT, bytearray(body))
    if not all_finite(array):
        raise RejectedError("not-finite")
    return array
