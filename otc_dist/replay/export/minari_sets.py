"""Minari data sets `agent_0-v0`, ..., `joint-v0`, with PATH as $MINARI_DATASETS_PATH.

Minari holds one observation more than actions, and no successors: where the successor of a step
is not what was seen next, which no environment of ours does, an episode is cut in two. The joint
set has dictionaries by agent; its rewards are the agents' mean, with each agent's own in `infos`.

The metadata are written by Minari. The episodes are not: by way of h5py's high-level interface,
ten thousand of them take a minute.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import h5py
import minari
import numpy as np
from h5py import h5a, h5d, h5g, h5s, h5t
from minari.dataset.minari_storage import MinariStorage
from numpy.typing import NDArray

from otc_dist.replay.export.formats import View
from otc_dist.replay.export.trajectories import Trajectory
from otc_dist.spec import AgentSpec

_SCALAR = h5s.create(h5s.SCALAR)
_TYPES = {np.dtype(kind): h5t.py_create(np.dtype(kind)) for kind in ("f4", "f8", "?")}


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
        self._file = h5py.File(data / "main_data.hdf5", "w")
        self._episodes = self._steps = 0

    def _by_agent(self, spaces: Sequence[gymnasium.Space[Any]]) -> gymnasium.Space[Any]:
        if self._view.agent is not None:
            return spaces[0]
        return gymnasium.spaces.Dict(dict(zip(self._view.team.names, spaces, strict=True)))

    def write(self, batch: Sequence[Trajectory]) -> None:
        for part in batch:
            for start, stop in self._chains(part):
                self._write_episode(part, start, stop)
        self._file.flush()  # what is kept back could find the disk full

    def _write_episode(self, part: Trajectory, start: int, stop: int) -> None:
        group = h5g.create(self._file.id, f"episode_{self._episodes}".encode())
        numbers = {
            "id": self._episodes,
            "total_steps": stop - start,
            "seed": part.seed,
            "options/log": part.log,
            "options/deployment": part.deployment,
            "options/copy": part.copy,
            "options/step": part.start + start,
        }
        for name, number in numbers.items():
            attribute = h5a.create(group, name.encode(), h5t.NATIVE_INT64, _SCALAR)
            attribute.write(np.array(number))
        rows = slice(start, stop)
        seen, actions, rewards = {}, {}, {}
        for i in self._view.agents:
            name, last = self._view.team.names[i], part.next_observations[i][stop - 1 : stop]
            seen[name] = np.concatenate((part.observations[i][rows], last))
            actions[name], rewards[name] = part.actions[i][rows], part.rewards[i][rows]
        tree: dict[str, Any] = {
            "terminations": part.terminated[rows],
            "truncations": part.truncated[rows],
        }
        if self._view.agent is None:
            tree |= {"observations": seen, "actions": actions, "infos": {"rewards": rewards}}
            tree["rewards"] = np.mean(list(rewards.values()), axis=0, dtype=np.float64)
        else:
            own = self._view.name
            tree |= {"observations": seen[own], "actions": actions[own], "rewards": rewards[own]}
        _write(group, tree)
        self._episodes += 1
        self._steps += stop - start

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
        self._file.close()
        self._storage.update_metadata(
            {
                "total_episodes": self._episodes,
                "total_steps": self._steps,
                "dataset_size": self._storage.get_size(),
            }
        )


def _write(group: h5g.GroupID, tree: Mapping[str, Any]) -> None:
    """Arrays by name; what holds more of them becomes a group."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            _write(h5g.create(group, name.encode()), value)
        else:
            array = np.ascontiguousarray(value)
            space = h5s.create_simple(array.shape)
            data = h5d.create(group, name.encode(), _TYPES[array.dtype], space)
            data.write(h5s.ALL, h5s.ALL, array)


def _observation_space(agent: AgentSpec) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-np.inf, np.inf, (agent.observation_size,), np.float32)


def _action_space(agent: AgentSpec) -> gymnasium.spaces.Box:
    low, high = (np.array(bound, np.float32) for bound in (agent.action_low, agent.action_high))
    return gymnasium.spaces.Box(low, high, dtype=np.float32)
