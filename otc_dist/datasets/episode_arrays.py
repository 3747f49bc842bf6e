"""Episodes as they were played, and the arrays of a data set that they fill."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.source import ActionSlices
from otc_dist.envs import registry
from otc_dist.spec import TeamSpec
from otc_dist.transitions import Bool, Float32


@dataclass(frozen=True)
class ObservationViews:
    """Agents that are given the same array of observations share a view, which is kept once."""

    of_agents: tuple[int, ...]  # the view of each agent
    viewers: tuple[int, ...]  # one agent of each view
    sizes: tuple[int, ...]  # observation size of each view

    @classmethod
    def of(cls, env_id: str) -> Self:
        """Raises UserError for an unknown environment."""
        env = registry.make(env_id, 1)
        env.reset(np.zeros(1, np.int64), np.zeros(1, np.int64))
        observed = env.observe()
        env.close()
        firsts = [next(i for i, x in enumerate(observed) if x is y) for y in observed]
        viewers = sorted(set(firsts))
        return cls(
            tuple(viewers.index(first) for first in firsts),
            tuple(viewers),
            tuple(observed[viewer].shape[1] for viewer in viewers),
        )

    def to_agents(self, arrays: Sequence[Float32]) -> tuple[Float32, ...]:
        """One array per agent, from one array per view."""
        return tuple(arrays[view] for view in self.of_agents)

    def from_agents(self, arrays: Sequence[Float32]) -> tuple[Float32, ...]:
        """One array per view, from one array per agent."""
        return tuple(arrays[viewer] for viewer in self.viewers)


@dataclass(frozen=True)
class PlayedEpisode:
    """One episode: what was seen, views x (T + 1, O), joint actions (T, A), rewards (T, N)."""

    seen: tuple[Float32, ...]
    actions: Float32
    rewards: Float32
    terminated: bool


class EpisodeArrays:
    """The arrays of a data set of `count` transitions, filled in the order of the rows."""

    def __init__(self, team: TeamSpec, views: ObservationViews, count: int) -> None:
        self._views, self._slices = views, ActionSlices(team)
        self._observations = [np.empty((count, size), np.float32) for size in views.sizes]
        self._successors = [np.empty((count, size), np.float32) for size in views.sizes]
        self._actions = np.empty((count, self._slices.total), np.float32)
        self._rewards = np.empty((len(team.agents), count), np.float32)
        self._terminated: Bool = np.zeros(count, np.bool_)
        self._truncated: Bool = np.zeros(count, np.bool_)
        self._episodes = np.empty(count, np.int64)

    def __len__(self) -> int:
        return len(self._episodes)

    def write(self, start: int, stop: int, played: PlayedEpisode) -> int:
        """Write one episode from row `start`, cut at row `stop`; returns the row after it.

        An episode that broke off in its first step has none to write.
        """
        if not len(played.rewards):
            return start
        episode = int(self._episodes[start - 1]) + 1 if start else 0
        length = min(len(played.rewards), stop - start)
        end = start + length
        for view, seen in enumerate(played.seen):
            self._observations[view][start:end] = seen[:length]
            self._successors[view][start:end] = seen[1 : length + 1]
        self._actions[start:end] = played.actions[:length]
        self._rewards[:, start:end] = played.rewards[:length].T
        self._episodes[start:end] = episode
        whole = length == len(played.rewards)
        self._terminated[end - 1] = whole and played.terminated
        self._truncated[end - 1] = not self._terminated[end - 1]
        return end

    def joint(self) -> JointTransitions:
        """All rows; agents that see the same thing share an array."""
        return JointTransitions(
            observations=self._views.to_agents(self._observations),
            actions=tuple(map(np.ascontiguousarray, self._slices.split(self._actions))),
            rewards=tuple(self._rewards),
            next_observations=self._views.to_agents(self._successors),
            terminated=self._terminated,
            truncated=self._truncated,
            episodes=self._episodes,
        )
