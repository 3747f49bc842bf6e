"""What is published: the env host's questions, the learners' answers, and statuses of all."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from otc_dist.bus.wire import (
    PROTOCOL_VERSION,
    RejectedError,
    booleans,
    floats,
    name,
    natural,
    number,
    pack,
    raw,
    unpack,
)
from otc_dist.spec import AgentSpec
from otc_dist.transitions import Bool, Float32

Phase = Literal["deployment", "evaluation", "done"]
_PHASES: Mapping[str, int] = {"deployment": 0, "evaluation": 1, "done": 2}
POLICY_DIGEST_LENGTH = 16
_MOST_METRICS = 256


class Moment(NamedTuple):
    """Where a run stands.

    Deployment k is played by pi_{k-1}; evaluation k judges pi_k; the run ends `done` when all
    learners hold pi_K. The epoch is raised whenever the env host starts again.
    """

    phase: Phase
    deployment: int
    epoch: int
    step: int

    @property
    def position(self) -> tuple[int, int, int]:
        """Sorts moments as a run meets them, within an epoch: deployment, evaluation, done."""
        return self.deployment, _PHASES[self.phase], self.step

    @property
    def policy(self) -> int:
        """k of the policy pi_k that is asked."""
        return self.deployment - 1 if self.phase == "deployment" else self.deployment


@dataclass(frozen=True)
class StepOutcome:
    """What the step before brought one agent, in E copies."""

    rewards: Float32  # (E,)
    next_observations: Float32  # (E, observation_size)
    terminated: Bool  # (E,)
    truncated: Bool  # (E,)


@dataclass(frozen=True)
class Observation:
    """The env host's question to one agent: what do you do now?

    The last question of a deployment (step == its number of steps) only carries the outcome of
    the last step; so does `done` carry nothing. Both are answered without an action.
    """

    moment: Moment
    observations: Float32 | None  # (E, observation_size); None when done
    outcome: StepOutcome | None  # of step - 1; None at step 0, in evaluations and when done


@dataclass(frozen=True)
class Action:
    """An agent's answer."""

    moment: Moment
    actions: Float32 | None  # (E, action_size); None: nothing to do
    policy: str  # digest of the policy that acted, 16 hexadecimal digits


class AgentCodec:
    """Encodes and decodes the lock-step messages of one agent in one run.

    Args:
        run: the run's name.
        agent: the agent's sizes.
        copies: E, by phase.

    The decoders raise RejectedError for anything that does not match, exactly.
    """

    def __init__(self, run: str, agent: AgentSpec, copies: Mapping[str, int]) -> None:
        self.agent = agent
        self._run = run
        self._copies = copies

    def _head(self, moment: Moment) -> list[object]:
        return [PROTOCOL_VERSION, self._run, self.agent.name, *moment]

    def _unpack(self, payload: bytes, count: int) -> tuple[Moment, list[object]]:
        fields = unpack(payload, self._run, 7 + count)
        if fields[2] != self.agent.name:
            raise RejectedError("agent")
        phase = name(fields[3])
        if phase not in _PHASES:
            raise RejectedError("phase")
        moment = Moment(phase, natural(fields[4]), natural(fields[5]), natural(fields[6]))  # type: ignore[arg-type]
        return moment, fields[7:]

    def encode_observation(self, message: Observation) -> bytes:
        outcome = message.outcome
        seen = b"" if message.observations is None else raw(message.observations)
        if outcome is None:
            return pack([*self._head(message.moment), seen, b"", b"", b"", b""])
        return pack(
            [
                *self._head(message.moment),
                seen,
                raw(outcome.rewards),
                raw(outcome.next_observations),
                raw(outcome.terminated),
                raw(outcome.truncated),
            ]
        )

    def decode_observation(self, payload: bytes) -> Observation:
        moment, (seen, *outcome) = self._unpack(payload, 5)
        copies, size = self._copies[moment.phase], self.agent.observation_size
        if moment.phase == "done":
            if any(part != b"" for part in (seen, *outcome)):
                raise RejectedError("shape")
            return Observation(moment, None, None)
        observations = floats(seen, copies, size)
        if moment.phase == "evaluation" or moment.step == 0:
            if any(part != b"" for part in outcome):
                raise RejectedError("shape")
            return Observation(moment, observations, None)
        rewards, next_observations, terminated, truncated = outcome
        return Observation(
            moment,
            observations,
            StepOutcome(
                floats(rewards, copies),
                floats(next_observations, copies, size),
                booleans(terminated, copies),
                booleans(truncated, copies),
            ),
        )

    def encode_action(self, message: Action) -> bytes:
        actions = b"" if message.actions is None else raw(message.actions)
        return pack([*self._head(message.moment), actions, message.policy])

    def decode_action(self, payload: bytes, asked: Moment, *, acting: bool) -> Action:
        """`asked`: the moment that must be answered; `acting`: with an action, or with none."""
        moment, (actions, policy) = self._unpack(payload, 2)
        if moment != asked:
            raise RejectedError("epoch" if moment.epoch != asked.epoch else "stale")
        if len(name(policy)) != POLICY_DIGEST_LENGTH:
            raise RejectedError("policy")
        copies = self._copies[moment.phase] if acting else 0
        array = floats(actions, copies, self.agent.action_size)
        return Action(moment, array if acting else None, str(policy))


@dataclass(frozen=True)
class Status:
    """What a process does.

    phase: of a learner "starting", "embedding", "offline", "tuning", "ready"; of the env host
        "starting", "evaluation", "deployment", "done".
    update, total: updates of a learner, steps of the env host, done and to be done in the phase.
    rate: updates or steps a second, measured between two statuses.
    metrics: named numbers, all finite; `rejected/{reason}` counts rejected messages.
    """

    process: str
    phase: str = "starting"
    deployment: int = 0
    update: int = 0
    total: int = 0
    rate: float = 0.0
    metrics: Mapping[str, float] = field(default_factory=dict)


def encode_status(run: str, status: Status) -> bytes:
    """Metrics that are not finite are left out."""
    metrics = {key: float(x) for key, x in status.metrics.items() if math.isfinite(x)}
    head = [PROTOCOL_VERSION, run, status.process, status.phase, status.deployment]
    return pack([*head, status.update, status.total, status.rate, metrics])


def decode_status(payload: bytes, run: str, process: str) -> Status:
    """Raises RejectedError for anything but a status of `process`."""
    _, _, sender, phase, deployment, update, total, rate, metrics = unpack(payload, run, 9)
    if sender != process:
        raise RejectedError("agent")
    if type(metrics) is not dict or len(metrics) > _MOST_METRICS:
        raise RejectedError("type")
    return Status(
        process,
        name(phase),
        natural(deployment),
        natural(update),
        natural(total),
        number(rate),
        {name(key): number(value) for key, value in metrics.items()},
    )
