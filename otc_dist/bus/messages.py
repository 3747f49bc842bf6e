"""What is published: the env host's questions, the learners' answers, and statuses of all.

Questions and answers are made into bytes by `codec`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Self

from otc_dist.bus.wire import (
    PROTOCOL_VERSION,
    RejectedError,
    name,
    natural,
    number,
    pack,
    unpack,
)
from otc_dist.transitions import Bool, Float32, JointStep

Phase = Literal["deployment", "evaluation", "done"]
PHASES: Mapping[Phase, int] = {"deployment": 0, "evaluation": 1, "done": 2}
_MOST_METRICS = 256
_MOST_AWAITED = 10_000


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
        return self.deployment, PHASES[self.phase], self.step

    @property
    def policy(self) -> int:
        """k of the policy pi_k that is asked."""
        return self.deployment - 1 if self.phase == "deployment" else self.deployment


class StepOutcome(NamedTuple):
    """What the step before brought one agent, in E copies."""

    rewards: Float32  # (E,)
    next_observations: Float32  # (E, observation_size)
    terminated: Bool  # (E,)
    truncated: Bool  # (E,)

    @classmethod
    def of(cls, step: JointStep, index: int) -> Self:
        """What `step` brought agent number `index`."""
        successors = step.next_observations[index]
        return cls(step.rewards[index], successors, step.terminated, step.truncated)


class Observation(NamedTuple):
    """The env host's question to one agent: what do you do now?

    The last question of a deployment (step == its number of steps) only carries the outcome of
    the last step; so does `done` carry nothing. Both are answered without an action.
    """

    moment: Moment
    observations: Float32 | None  # (E, observation_size); None when done
    outcome: StepOutcome | None  # of step - 1; None at step 0, in evaluations and when done


class Action(NamedTuple):
    """An agent's answer."""

    moment: Moment
    actions: Float32 | None  # (E, action_size); None: nothing to do
    policy: str  # digest of the policy that acted, 16 hexadecimal digits


@dataclass(frozen=True)
class Status:
    """What a process does.

    phase: of a learner "starting", "offline", "embedding" or "dynamics" (what its distance
        fits to B_0), "tuning", "ready"; of the env host
        "starting", "evaluation", "deployment", "done".
    update, total: updates of a learner, steps of the env host, done and to be done in the phase.
    rate: updates or steps a second, measured between two statuses.
    metrics: named numbers, all finite; `rejected/{reason}` counts rejected messages.
    awaits: of the env host, the agents without whose answers it does not go on; while there are
        none, it is the env host that works.
    start, beat: a number drawn when the process started, and how many statuses it has sent since:
        one that was recorded and is sent again is no sign of life, whatever the clocks say.
    """

    process: str
    phase: str = "starting"
    deployment: int = 0
    update: int = 0
    total: int = 0
    rate: float = 0.0
    metrics: Mapping[str, float] = field(default_factory=dict)
    awaits: tuple[str, ...] = ()
    start: int = 0
    beat: int = 0


def encode_status(run: str, status: Status) -> bytes:
    """Metrics that are not finite are left out."""
    metrics = {key: float(x) for key, x in status.metrics.items() if math.isfinite(x)}
    head = [PROTOCOL_VERSION, run, status.process, status.phase, status.deployment]
    body = [status.update, status.total, status.rate, metrics, list(status.awaits)]
    return pack([*head, *body, status.start, status.beat])


def decode_status(payload: bytes, run: str, process: str) -> Status:
    """Raises RejectedError for anything but a status of `process`."""
    fields = unpack(payload, run, 12)
    _, _, sender, phase, deployment, update, total, rate, metrics, awaits, start, beat = fields
    if sender != process:
        raise RejectedError("agent")
    if type(metrics) is not dict or len(metrics) > _MOST_METRICS:
        raise RejectedError("type")
    if type(awaits) is not list or len(awaits) > _MOST_AWAITED:
        raise RejectedError("type")
    return Status(
        process,
        name(phase),
        natural(deployment),
        natural(update),
        natural(total),
        number(rate),
        {name(key): number(value) for key, value in metrics.items()},
        tuple(map(name, awaits)),
        natural(start),
        natural(beat),
    )
