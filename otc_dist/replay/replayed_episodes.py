"""A deployment played again: every episode from its seed, with the actions that were logged.

Observations, rewards and ends are compared with the log to the bit. The log is followed, not a
`Rollout`: copies are reset where the log says that an episode ended, to the seed that it says came
next, so that one wrong episode does not make all later ones wrong. Whether these are the seeds of
the run is checked elsewhere. Behind a gap the simulator goes on from the logged state.
"""

import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.description import progress
from otc_dist.envs import registry
from otc_dist.envs.base import BatchedEnv, Versioned
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32, Float64, JointStep


@dataclass(frozen=True)
class Difference:
    """Where an episode first differs from the log."""

    step: int
    copy: int
    what: str


@dataclass
class Comparison:
    """What was compared: `episodes` include those that the log does not hold to their end."""

    steps: int = 0
    episodes: int = 0
    differences: list[Difference] = field(default_factory=list)  # at most one an episode


@dataclass
class OneStepErrors:
    """How far single steps from the logged states go astray in another simulator.

    observations: largest error of each step's worst coordinate, in standard deviations of that
        coordinate over the log, (steps x copies,); rewards: absolute errors, as long.
    """

    observations: Float64
    rewards: Float64
    ends: int  # steps that end differently


def simulator(log: OpenLog) -> BatchedEnv:
    """The environment of a log, in as many copies.

    Raises:
        UserError: it is not known or not installed here, or has other agents.
    """
    header = log.header
    try:
        # Not by `Description`: what else an older version wrote there need not be understood.
        count = tomllib.loads(header.description)["deployment"]["count"]
        env = registry.make(
            header.team.env_id, header.copies, progress(header.deployment, int(count))
        )
    except (ValueError, RecursionError, KeyError, TypeError):
        raise UserError(f"the description in {log.path} lacks deployment.count") from None
    except UserError as error:
        raise UserError(f"{log.path} cannot be played again here: {error}") from None
    if env.spec != header.team:
        env.close()
        raise UserError(
            f"{log.path} was played in another {header.team.env_id}, of otc_dist"
            f" {header.versions.get('otc_dist', '?')}: agents or sizes differ from this one's"
        )
    return env


def other_versions(log: OpenLog, env: BatchedEnv) -> list[str]:
    """How the simulator differs from the log's: "mujoco 3.2.1 there, 4.0.0 here"."""
    here = env.versions if isinstance(env, Versioned) else {}
    there = log.header.versions
    return [
        f"{name} {there.get(name, '?')} there, {version} here"
        for name, version in here.items()
        if there.get(name) != version
        and (name in there or not name.endswith(" sha256"))  # older logs name fewer of them
    ]


def compare(header: LogHeader, steps: Iterable[JointStep], env: BatchedEnv) -> Comparison:
    """Play logged steps, in order, in an `env` of as many copies."""
    found = Comparison()
    copies = np.arange(header.copies)
    wrong = np.zeros(header.copies, np.bool_)  # copies whose episode has differed already
    before: JointStep | None = None

    def differ(step: int, where: Bool, what: str) -> None:
        for copy in np.flatnonzero(where & ~wrong).tolist():
            found.differences.append(Difference(step, copy, what))
        wrong[where] = True

    for logged in steps:
        seeds = logged.episode_seeds
        if before is None or logged.step != before.step + 1:
            env.reset(copies, seeds)
            if logged.step > 0:
                env.set_state(logged.state)
            begun = np.ones(header.copies, np.bool_)
        else:
            begun = before.terminated | before.truncated
            if begun.any():
                env.reset(np.flatnonzero(begun), seeds[begun])
        found.episodes += int(begun.sum())
        wrong[begun] = False
        differ(logged.step, _unequal((env.state(),), (logged.state,)), "the simulator's state")
        differ(logged.step, _unequal(env.observe(), logged.observations), "an observation")
        outcome = env.step(logged.actions)
        differ(logged.step, _unequal(outcome.rewards, logged.rewards), "a reward")
        ends = ((outcome.terminated, outcome.truncated), (logged.terminated, logged.truncated))
        differ(logged.step, _unequal(*ends), "the episode's end")
        differ(logged.step, _unequal(env.observe(), logged.next_observations), "a next observation")
        found.steps += 1
        before = logged
    return found


def one_step_errors(steps: Callable[[], Iterable[JointStep]], env: BatchedEnv) -> OneStepErrors:
    """Set each logged state, make one step, and compare; `steps` gives the steps twice."""
    observed = np.concatenate([np.concatenate(step.observations, 1) for step in steps()])
    scale = observed.std(axis=0) + np.float32(1e-6)
    observations, rewards, ends = [], [], 0
    for number, logged in enumerate(steps()):
        if number == 0:
            env.reset(np.arange(env.copies), logged.episode_seeds)
        env.set_state(logged.state)
        outcome = env.step(logged.actions)
        error = np.concatenate(env.observe(), 1) - np.concatenate(logged.next_observations, 1)
        observations.append(np.abs(error / scale).max(axis=1))
        pairs = zip(outcome.rewards, logged.rewards, strict=True)
        rewards.append(np.max([np.abs(mine - theirs) for mine, theirs in pairs], axis=0))
        differ = (outcome.terminated, outcome.truncated), (logged.terminated, logged.truncated)
        ends += int(_unequal(*differ).sum())
    return OneStepErrors(np.concatenate(observations), np.concatenate(rewards), ends)


def _unequal(
    mine: Sequence[Float32 | Float64 | Bool], theirs: Sequence[Float32 | Float64 | Bool]
) -> Bool:
    """In which copies (E,) arrays (E, ...) differ in a bit."""
    unequal = np.zeros(len(mine[0]), np.bool_)
    for a, b in zip(mine, theirs, strict=True):
        if a.tobytes() != b.tobytes():
            unequal |= (_bytes_of(a) != _bytes_of(b)).any(axis=1)
    return unequal


def _bytes_of(array: Float32 | Float64 | Bool) -> NDArray[np.uint8]:
    return np.ascontiguousarray(array).view(np.uint8).reshape(len(array), -1)
