"""Make a robot's offline data set B_0 by playing shipped behaviour policies.

- `random`: uniform actions.
- `medium`: stochastic samples of the medium snapshot.
- `medium-replay`: a labelled mixture of the snapshots from the untrained policy to the medium
  one, in training order and with equal shares. It stands in for a replay buffer of training.

The same arguments give the same rows: an episode's initial state and its action noise are
functions of (seed, robot, level, part, number of the episode) alone, and rows are ordered by
episode, whatever the number of copies that play at the same time. A longer data set of one
policy begins with the rows of a shorter one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from otc_dist.datasets.behaviour import BehaviourPolicy, load_card, load_policy
from otc_dist.datasets.joint import JointTransitions
from otc_dist.envs.robot_specs import MAX_EPISODE_STEPS, PARTITIONS, Robot, single_agent_id
from otc_dist.envs.robots import RobotEnv
from otc_dist.errors import UserError, unknown
from otc_dist.randomness import derive_seed, stream
from otc_dist.transitions import Bool, Float32

Level = Literal["random", "medium", "medium-replay"]
LEVELS: tuple[Level, ...] = get_args(Level)
Progress = Callable[[int, int], None]  # (transitions done, transitions in all)

_ONE_POLICY = 1_000_000
# The sizes of D4RL's `-v2` data, in transitions. Their medium-replay sizes: Fu et al. 2020.
_REPLAY = {"hopper": 402_000, "halfcheetah": 202_000, "walker2d": 302_000}

# Copies that play at the same time: enough to share the policy's cost and to use some threads,
# but few enough that little is played beyond the last row.
_MAX_COPIES = 128


@dataclass(frozen=True)
class Part:
    """Consecutive rows of a data set that one policy made."""

    policy: str  # "uniform", or the stem of a snapshot's file
    start: int  # first row
    stop: int  # behind the last row


def default_transitions(env_id: str, level: Level) -> int:
    """The size of D4RL's data set of that robot and level."""
    robot = _robot(env_id)
    return _REPLAY[robot.name] if level == "medium-replay" else _ONE_POLICY


def parts(env_id: str, level: Level, transitions: int) -> tuple[Part, ...]:
    """Which policy makes which rows of a data set, in order.

    Raises:
        UserError: not a robot, an unknown level, or fewer transitions than policies.
    """
    robot = _robot(env_id)
    if level not in LEVELS:
        raise unknown("level", level, LEVELS)
    if level == "random":
        names = ["uniform"]
    else:
        snapshots = load_card(robot.name).snapshots
        chosen = snapshots if level == "medium-replay" else snapshots[-1:]
        names = [snapshot.file.removesuffix(".safetensors") for snapshot in chosen]
    if transitions < len(names):
        raise UserError(f"{level} data need at least {len(names)} transitions, not {transitions}")
    bounds = [transitions * index // len(names) for index in range(len(names) + 1)]
    return tuple(Part(*row) for row in zip(names, bounds[:-1], bounds[1:], strict=True))


def generate(
    env_id: str,
    level: Level,
    transitions: int,
    seed: int = 0,
    progress: Progress | None = None,
) -> JointTransitions:
    """Play and return exactly `transitions` joint transitions of a robot environment.

    The last episode of each part is cut where the part is full, and its last row is marked as
    truncated: a limit that is not the task's ended it.

    Args:
        env_id: a robot environment, such as "hopper-3x1". The partition into agents only splits
            the action vector: all partitions of one robot get the same data.
        progress: called now and then with (rows done, rows in all).

    Raises:
        UserError: as `parts`.
    """
    robot = _robot(env_id)
    rows = _Rows.empty(robot, transitions)
    for part in parts(env_id, level, transitions):
        if part.policy == "uniform":
            policy = None
        else:
            snapshots = load_card(robot.name).snapshots
            policy = load_policy(
                robot.name, next(s for s in snapshots if s.file.startswith(part.policy))
            )
        _play(robot, policy, (seed, robot.name, level, part.policy), rows, part, progress)
    _, agents = PARTITIONS[env_id]
    return JointTransitions(
        observations=(rows.observations,) * agents,
        actions=tuple(np.ascontiguousarray(x) for x in np.split(rows.actions, agents, axis=1)),
        rewards=(rows.rewards,) * agents,
        next_observations=(rows.next_observations,) * agents,
        terminated=rows.terminated,
        truncated=rows.truncated,
        episodes=rows.episodes,
    )


def _robot(env_id: str) -> Robot:
    if env_id not in PARTITIONS:
        raise unknown("robot environment", env_id, PARTITIONS)
    return PARTITIONS[env_id][0]


@dataclass(frozen=True)
class _Rows:
    """The arrays under construction, filled in the order of the rows."""

    observations: Float32
    actions: Float32
    rewards: Float32
    next_observations: Float32
    terminated: Bool
    truncated: Bool
    episodes: np.ndarray[tuple[int], np.dtype[np.int64]]

    @classmethod
    def empty(cls, robot: Robot, count: int) -> "_Rows":
        observation = (count, robot.observation_size)
        return cls(
            np.empty(observation, np.float32),
            np.empty((count, robot.actuators), np.float32),
            np.empty(count, np.float32),
            np.empty(observation, np.float32),
            np.zeros(count, np.bool_),
            np.zeros(count, np.bool_),
            np.empty(count, np.int64),
        )

    def write(self, start: int, stop: int, episode: int, played: "_Played") -> int:
        """Write one episode from row `start`, cut at row `stop`; returns the row behind it."""
        length = min(len(played.rewards), stop - start)
        end = start + length
        self.observations[start:end] = played.observations[:length]
        self.next_observations[start:end] = played.observations[1 : length + 1]
        self.actions[start:end] = played.actions[:length]
        self.rewards[start:end] = played.rewards[:length]
        self.episodes[start:end] = episode
        whole = length == len(played.rewards)
        self.terminated[end - 1] = whole and played.terminated
        self.truncated[end - 1] = not self.terminated[end - 1]
        return end


@dataclass(frozen=True)
class _Played:
    """One episode: observations (T + 1, O) with the final one, actions (T, A), rewards (T,)."""

    observations: Float32
    actions: Float32
    rewards: Float32
    terminated: bool


class _Copies:
    """The episodes in progress: E copies, each with its number, its step and its history."""

    def __init__(self, robot: Robot, copies: int, key: tuple[int, str, str, str], uniform: bool):
        self.env = RobotEnv(single_agent_id(robot.name), copies)
        self.episode = np.zeros(copies, np.int64)
        self.time = np.zeros(copies, np.int64)
        self.observations = np.empty(
            (copies, MAX_EPISODE_STEPS + 1, robot.observation_size), np.float32
        )
        self.actions = np.empty((copies, MAX_EPISODE_STEPS, robot.actuators), np.float32)
        self.rewards = np.empty((copies, MAX_EPISODE_STEPS), np.float32)
        self.noise = np.empty_like(self.actions)
        self._key, self._uniform, self._started = key, uniform, 0

    def start(self, which: np.ndarray[tuple[int], np.dtype[np.int64]]) -> None:
        """Start the next episodes in the copies `which`, in order."""
        seed, *key = self._key
        seeds = np.empty(len(which), np.int64)
        for index, copy in enumerate(which.tolist()):
            number, self._started = self._started, self._started + 1
            self.episode[copy] = number
            seeds[index] = derive_seed(seed, *key, number)
            draw, shape = stream(seed, *key, number), self.noise.shape[1:]
            if self._uniform:
                self.noise[copy] = 2.0 * draw.random(shape, np.float32) - 1.0
            else:
                self.noise[copy] = draw.standard_normal(shape, np.float32)
        self.env.reset(which, seeds)
        self.time[which] = 0
        self.observations[which, 0] = self.env.observe()[0][which]

    def played(self, copy: int, terminated: bool) -> _Played:
        """A copy of what `copy` has played of its episode."""
        length = int(self.time[copy])
        return _Played(
            self.observations[copy, : length + 1].copy(),
            self.actions[copy, :length].copy(),
            self.rewards[copy, :length].copy(),
            terminated,
        )


def _play(
    robot: Robot,
    policy: BehaviourPolicy | None,
    key: tuple[int, str, str, str],
    rows: _Rows,
    part: Part,
    progress: Progress | None,
) -> None:
    """Fill the rows of `part` with episodes of `policy` (None: uniform actions)."""
    copies = max(1, min(_MAX_COPIES, (part.stop - part.start) // MAX_EPISODE_STEPS))
    now = _Copies(robot, copies, key, uniform=policy is None)
    everyone = np.arange(copies)
    now.start(everyone)
    first_id = int(rows.episodes[part.start - 1]) + 1 if part.start else 0
    # Episodes end in any order, but rows are written in the order of their numbers.
    ended: dict[int, _Played] = {}
    number, filled, steps = 0, part.start, 0
    while filled < part.stop:
        observations, noise = now.observations[everyone, now.time], now.noise[everyone, now.time]
        actions = noise if policy is None else policy.act(observations, noise)
        outcome = now.env.step([actions])
        now.actions[everyone, now.time] = actions
        now.rewards[everyone, now.time] = outcome.rewards[0]
        now.time += 1
        now.observations[everyone, now.time] = now.env.observe()[0]
        which = np.flatnonzero(outcome.terminated | outcome.truncated)
        for copy in which.tolist():
            ended[int(now.episode[copy])] = now.played(copy, bool(outcome.terminated[copy]))
        if len(which):
            now.start(which)
        while number in ended and filled < part.stop:
            filled = rows.write(filled, part.stop, first_id + number, ended.pop(number))
            number += 1
        # The episode whose turn it is may be long enough already for the rows that are left.
        current = np.flatnonzero(now.episode == number)
        if filled < part.stop and filled + int(now.time[current].sum()) >= part.stop:
            played = now.played(int(current[0]), terminated=False)
            filled = rows.write(filled, part.stop, first_id + number, played)
        steps += 1
        if progress is not None and (steps % 64 == 0 or filled == part.stop):
            progress(filled, len(rows.episodes))
