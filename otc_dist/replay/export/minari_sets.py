"""Minari data sets `agent_0-v0`, ..., `joint-v0`, with PATH as $MINARI_DATASETS_PATH.

Minari holds one observation more than actions, and no successors: where the successor of a step
is not what was seen next, which no environment of ours does, an episode is cut in two. The joint
set has dictionaries by agent; its rewards are the agents' mean, with each agent's own in `infos`.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_storage import MinariStorage
from numpy.typing import NDArray

from otc_dist.replay.export.formats import View
from otc_dist.replay.export.trajectories import Trajectory
from otc_dist.spec import AgentSpec


def open_writer(folder: Path, view: View) -> "MinariWriter":
    """A `Writer` of one Minari data set."""
    return MinariWriter(folder, view)


class MinariWriter:
    """Writes one data set."""

    def __init__(self, folder: Path, view: View) -> None:
        self._view = view
        name = f"{view.name}-v0"
        data = folder.absolute() / name / "data"  # Minari looks for a relative one in itself
        data.mkdir(parents=True)
        agents = [view.team.agents[i] for i in view.agents]
        self._storage = MinariStorage.new(
            data,
            observation_space=self._by_agent([_observation_space(agent) for agent in agents]),
            action_space=self._by_agent([_action_space(agent) for agent in agents]),
            data_format="hdf5",
            jpeg_encoding=False,
        )
        self._storage.update_metadata(
            {
                "dataset_id": name,
                "minari_version": minari.__version__,
                "algorithm_name": "deployed by otc_dist",
                "description": view.about,
            }
        )

    def _by_agent(self, spaces: Sequence[gymnasium.Space[Any]]) -> gymnasium.Space[Any]:
        if self._view.agent is not None:
            return spaces[0]
        return gymnasium.spaces.Dict(dict(zip(self._view.team.names, spaces, strict=True)))

    def write(self, batch: Sequence[Trajectory]) -> None:
        self._storage.update_episodes(
            self._episode(part, start, stop) for part in batch for start, stop in self._chains(part)
        )

    def _episode(self, part: Trajectory, start: int, stop: int) -> EpisodeBuffer:
        rows = slice(start, stop)
        seen = [
            np.concatenate((part.observations[i][rows], part.next_observations[i][stop - 1 : stop]))
            for i in self._view.agents
        ]
        actions = [part.actions[i][rows] for i in self._view.agents]
        rewards = [part.rewards[i][rows] for i in self._view.agents]
        place = {
            "log": part.log,
            "deployment": part.deployment,
            "copy": part.copy,
            "step": part.start + start,
        }
        joint = self._view.agent is None
        names = self._view.team.names
        return EpisodeBuffer(
            seed=part.seed,
            options=place,
            observations=dict(zip(names, seen, strict=True)) if joint else seen[0],
            actions=dict(zip(names, actions, strict=True)) if joint else actions[0],
            rewards=np.mean(rewards, axis=0, dtype=np.float64) if joint else rewards[0],
            terminations=part.terminated[rows],
            truncations=part.truncated[rows],
            infos={"rewards": dict(zip(names, rewards, strict=True))} if joint else None,
        )

    def _chains(self, part: Trajectory) -> Iterator[tuple[int, int]]:
        """Rows start..stop-1 within which each successor is the next observation, to the bit."""
        broken: NDArray[np.bool_] = np.zeros(len(part) - 1, np.bool_)
        for i in self._view.agents:
            seen, successors = (
                array.view(np.uint32) for array in (part.observations[i], part.next_observations[i])
            )
            broken |= (seen[1:] != successors[:-1]).any(axis=1)
        cuts = [0, *(int(row) + 1 for row in np.flatnonzero(broken)), len(part)]
        yield from pairwise(cuts)

    def close(self) -> None:
        """Nothing: each batch is written to its end."""


def _observation_space(agent: AgentSpec) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-np.inf, np.inf, (agent.observation_size,), np.float32)


def _action_space(agent: AgentSpec) -> gymnasium.spaces.Box:
    low, high = (np.array(bound, np.float32) for bound in (agent.action_low, agent.action_high))
    return gymnasium.spaces.Box(low, high, dtype=np.float32)
