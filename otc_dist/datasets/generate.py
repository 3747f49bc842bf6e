"""Make an offline data set B_0 by playing the behaviours of a task's `Source`.

The same arguments give the same rows: an episode's initial state and its action noise are
functions of (seed, task, level, part, number of the episode) alone, and rows are ordered by
episode, whatever the number of copies that play at the same time. A longer data set of one
policy begins with the rows of a shorter one.
"""

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.episode_arrays import EpisodeArrays, ObservationViews, PlayedEpisode
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.source import ActionSlices, Behaviour, Part, Source
from otc_dist.datasets.sources import source_of
from otc_dist.envs import registry
from otc_dist.envs.base import Outcome
from otc_dist.randomness import derive_seed, stream
from otc_dist.terminal.errors import UserError, unknown
from otc_dist.terminal.progress import Report, silent
from otc_dist.transitions import Float32

# Copies that play at the same time: enough to share the policy's cost and to use some threads,
# but few enough that little is played beyond the last row.
_MAX_COPIES = 128


def parts(env_id: str, level: str, transitions: int) -> tuple[Part, ...]:
    """Which behaviour makes which rows of a data set, in order.

    Raises:
        UserError: no task whose data we make, an unknown level, or fewer transitions than
            behaviours.
    """
    names = _source(env_id, level).policies(env_id, level)
    if transitions < len(names):
        raise UserError(f"{level} data need at least {len(names)} transitions, not {transitions}")
    bounds = [transitions * index // len(names) for index in range(len(names) + 1)]
    return tuple(Part(*row) for row in zip(names, bounds[:-1], bounds[1:], strict=True))


def generate(
    env_id: str,
    level: str,
    transitions: int,
    seed: int = 0,
    report: Report = silent,
) -> JointTransitions:
    """Play and return exactly `transitions` joint transitions of an environment.

    The last episode of each part is cut where the part is full, and its last row is marked as
    truncated: a limit that is not the task's ended it.

    Args:
        report: called now and then with (rows done, rows in all).

    Raises:
        UserError: as `parts`.
    """
    source, team, views = (
        _source(env_id, level),
        registry.team_spec(env_id),
        ObservationViews.of(env_id),
    )
    shares = parts(env_id, level, transitions)
    rows = EpisodeArrays(team, views, transitions)
    for part in shares:
        most = registry.affordable(env_id, _MAX_COPIES)
        copies = max(1, min(most, (part.stop - part.start) // team.max_episode_steps))
        key = (seed, source.seed_name(env_id), level, part.policy)
        now = _Copies(env_id, copies, views, source.behaviour(env_id, part.policy), key)
        _play(now, rows, part, report)
        now.env.close()
    return rows.joint()


def _source(env_id: str, level: str) -> Source:
    source = source_of(env_id)
    if source is None:
        raise unknown(
            "environment", env_id, [known for known in registry.env_ids() if source_of(known)]
        )
    if level not in source.levels(env_id):
        raise unknown("level", level, source.levels(env_id))
    return source


class _Copies:
    """The episodes in progress: E copies, each with its number, its step and its history."""

    def __init__(
        self,
        env_id: str,
        copies: int,
        views: ObservationViews,
        behaviour: Behaviour,
        key: tuple[int, str, str, str],
    ) -> None:
        self.env = registry.make(env_id, copies)
        team, self._views, self._behaviour, self._key = self.env.spec, views, behaviour, key
        self._steps = team.max_episode_steps
        self._everyone = np.arange(copies)
        self.episode = np.zeros(copies, np.int64)
        self._time = np.zeros(copies, np.int64)
        self._started = 0
        self._noise = np.empty((copies, *self._draw(0).shape), np.float32)
        self._seen = [np.empty((copies, self._steps + 1, size), np.float32) for size in views.sizes]
        total = ActionSlices(team).total
        self._actions = np.empty((copies, self._steps, total), np.float32)
        self._rewards = np.empty((copies, self._steps, len(team.agents)), np.float32)
        self.start(self._everyone)

    def _draw(self, number: int) -> Float32:
        seed, *key = self._key
        return self._behaviour.noise(stream(seed, *key, number), self._steps)

    def _see(self, which: NDArray[np.int64]) -> None:
        for seen, view in zip(self._seen, self._views.from_agents(self.env.observe()), strict=True):
            seen[which, self._time[which]] = view[which]

    def start(self, which: NDArray[np.int64]) -> None:
        """Start the next episodes in the copies `which`, in order."""
        seed, *key = self._key
        seeds = np.empty(len(which), np.int64)
        for index, copy in enumerate(which.tolist()):
            number, self._started = self._started, self._started + 1
            self.episode[copy], self._noise[copy] = number, self._draw(number)
            seeds[index] = derive_seed(seed, *key, number)
        self.env.reset(which, seeds)
        self._time[which] = 0
        self._see(which)

    def step(self) -> Outcome:
        """Let the behaviour play one step of all copies."""
        now = (self._everyone, self._time)
        observations = self._views.to_agents([seen[now] for seen in self._seen])
        actions = self._behaviour.act(observations, self._noise[now])
        outcome = self.env.step(actions)
        self._actions[now] = np.concatenate(actions, axis=1)
        self._rewards[now] = np.stack(outcome.rewards, axis=1)
        self._time += 1
        self._see(self._everyone)
        return outcome

    def length(self, episode: int) -> int:
        """Steps played of that episode; 0 if no copy plays it."""
        return int(self._time[self.episode == episode].sum())

    def played(self, copy: int, terminated: bool, broken: bool = False) -> PlayedEpisode:
        """A copy of what `copy` has played of its episode; a step that broke off is left out."""
        length = int(self._time[copy]) - broken
        return PlayedEpisode(
            tuple(seen[copy, : length + 1].copy() for seen in self._seen),
            self._actions[copy, :length].copy(),
            self._rewards[copy, :length].copy(),
            terminated and not broken,
        )


def _play(now: _Copies, rows: EpisodeArrays, part: Part, report: Report) -> None:
    """Fill the rows of `part` with episodes."""
    # Episodes end in any order, but rows are written in the order of their numbers.
    ended: dict[int, PlayedEpisode] = {}
    number, filled, steps = 0, part.start, 0
    while filled < part.stop:
        outcome = now.step()
        which = np.flatnonzero(outcome.terminated | outcome.truncated)
        for copy in which.tolist():
            terminated, truncated = bool(outcome.terminated[copy]), bool(outcome.truncated[copy])
            played = now.played(copy, terminated, broken=terminated and truncated)
            ended[int(now.episode[copy])] = played
        if len(which):
            now.start(which)
        while number in ended and filled < part.stop:
            filled = rows.write(filled, part.stop, ended.pop(number))
            number += 1
        # The episode whose turn it is may be long enough already for the rows that are left.
        if filled < part.stop and filled + now.length(number) >= part.stop:
            (current,) = np.flatnonzero(now.episode == number)
            played = now.played(int(current), terminated=False)
            filled = rows.write(filled, part.stop, played)
        steps += 1
        if steps % 64 == 0 or filled == part.stop:
            report(filled, len(rows))
