"""D4RL's HDF5 layout, one file per agent: `PATH/agent_0.hdf5`.

    observations, actions, rewards, terminals, timeouts, next_observations

Episodes stand one after the other, so wherever one stops without a terminal, `timeouts` is set:
where the time limit ended it, and where the log, or what was asked for, did.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from otc_dist.replay.export.formats import View
from otc_dist.replay.export.trajectories import Trajectory

_CHUNK = 4096  # rows


def open_writer(folder: Path, view: View) -> "D4RLWriter":
    """A `Writer` of one agent's data."""
    return D4RLWriter(folder / f"{view.name}.hdf5", view)


class D4RLWriter:
    """Writes one file."""

    def __init__(self, path: Path, view: View) -> None:
        (self._agent,) = view.agents
        spec = view.team.agents[self._agent]
        self._file = h5py.File(path, "w")
        self._file.attrs["otc_dist"] = view.about
        observation, action = (spec.observation_size,), (spec.action_size,)
        for name, shape, kind in (
            ("observations", observation, np.float32),
            ("actions", action, np.float32),
            ("rewards", (), np.float32),
            ("next_observations", observation, np.float32),
            ("terminals", (), np.bool_),
            ("timeouts", (), np.bool_),
        ):
            self._file.create_dataset(
                name, (0, *shape), kind, maxshape=(None, *shape), chunks=(_CHUNK, *shape)
            )

    def write(self, batch: Sequence[Trajectory]) -> None:
        i = self._agent
        self._append("observations", [part.observations[i] for part in batch])
        self._append("actions", [part.actions[i] for part in batch])
        self._append("rewards", [part.rewards[i] for part in batch])
        self._append("next_observations", [part.next_observations[i] for part in batch])
        self._append("terminals", [part.terminated for part in batch])
        self._append("timeouts", [_timeouts(part) for part in batch])
        self._file.flush()  # what is kept back could find the disk full

    def _append(self, name: str, parts: Sequence[NDArray[Any]]) -> None:
        rows, data = np.concatenate(parts), self._file[name]
        start = len(data)
        data.resize(start + len(rows), axis=0)
        data[start:] = rows

    def close(self) -> None:
        self._file.close()


def _timeouts(part: Trajectory) -> NDArray[np.bool_]:
    timeouts = part.truncated.copy()
    timeouts[-1] |= not part.terminated[-1]
    return timeouts
