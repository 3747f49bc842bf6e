"""LeRobot data sets, format v3.0: `PATH/agent_0/`, ..., `PATH/joint/`, each with

    data/chunk-000/file-000.parquetone row per step
    meta/episodes/chunk-000/file-000.parquet  a row a trajectory: its rows, and where it is from
    meta/tasks.parquet, meta/stats.json, meta/info.json

LeRobot has no successors: s' is the feature `next.observation.state`. Vectors of the joint set
are those of all agents, one after the other. One frame is one step: `fps` is 1.
"""

import json
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from otc_dist.replay.export.column_statistics import Statistics
from otc_dist.replay.export.formats import View
from otc_dist.replay.export.parquet_files import rows_writer
from otc_dist.replay.export.tables import Columns, to_table
from otc_dist.replay.export.trajectories import Trajectory

_FILE_MEGABYTES = 100  # a data file of more than that is the last of its kind
_FILES_A_CHUNK = 1000  # files in a folder
_FPS = 1


def open_writer(folder: Path, view: View) -> "LeRobotWriter":
    """A `Writer` of one LeRobot data set."""
    return LeRobotWriter(folder / view.name, view)


class LeRobotWriter:
    """Writes one data set."""

    def __init__(self, root: Path, view: View) -> None:
        self._root, self._view = root, view
        self._frames = self._trajectories = self._file = 0
        self._data: pq.ParquetWriter | None = None
        self._episodes: pq.ParquetWriter | None = None
        self._features: dict[str, dict[str, Any]] = {}
        self._statistics = Statistics()
        (root / "meta").mkdir(parents=True)

    def write(self, batch: Sequence[Trajectory]) -> None:
        columns = self._columns(batch)
        self._statistics.add(columns)
        if not self._features:
            self._features = _features(columns, self._view)
        path = self._root / "data" / _file(self._file)
        table = to_table(columns)
        if self._data is None:
            self._data = _begin(path, table.schema)
        self._data.write_table(table)
        self._write_episodes(batch)
        self._frames += table.num_rows
        self._trajectories += len(batch)
        if path.stat().st_size >= _FILE_MEGABYTES * 2**20:
            self._data.close()
            self._data, self._file = None, self._file + 1

    def _columns(self, batch: Sequence[Trajectory]) -> Columns:
        agents = self._view.agents
        frame_index = np.concatenate([np.arange(len(part)) for part in batch])
        numbers = np.arange(self._trajectories, self._trajectories + len(batch))
        found = {
            "observation.state": _joined([part.observations for part in batch], agents),
            "action": _joined([part.actions for part in batch], agents),
            "next.reward": _joined([part.rewards for part in batch], agents),
            "next.observation.state": _joined([part.next_observations for part in batch], agents),
            "next.done": np.concatenate([part.terminated | part.truncated for part in batch]),
            "next.terminated": np.concatenate([part.terminated for part in batch]),
            "next.truncated": np.concatenate([part.truncated for part in batch]),
            "exploring": _joined([part.exploring for part in batch], agents),
        }
        if self._view.agent is None and self._view.team.state_size:
            found["simulator_state"] = np.concatenate([part.state for part in batch])
        rows = len(frame_index)
        found |= {
            "timestamp": (frame_index / _FPS).astype(np.float32),
            "frame_index": frame_index,
            "episode_index": np.repeat(numbers, [len(part) for part in batch]),
            "index": np.arange(self._frames, self._frames + rows),
            "task_index": np.zeros(rows, np.int64),
        }
        # A vector of one entry is a number to LeRobot.
        return {name: x[:, 0] if x.shape[1:] == (1,) else x for name, x in found.items()}

    def _write_episodes(self, batch: Sequence[Trajectory]) -> None:
        lengths = [len(part) for part in batch]
        stops = [self._frames + stop for stop in accumulate(lengths)]
        chunk, file = divmod(self._file, _FILES_A_CHUNK)
        table = pa.table(
            {
                "episode_index": np.arange(self._trajectories, self._trajectories + len(batch)),
                "tasks": [[self._view.team.env_id]] * len(batch),
                "length": lengths,
                "dataset_from_index": [self._frames, *stops[:-1]],
                "dataset_to_index": stops,
                "data/chunk_index": [chunk] * len(batch),
                "data/file_index": [file] * len(batch),
                "meta/episodes/chunk_index": [0] * len(batch),
                "meta/episodes/file_index": [0] * len(batch),
                "log": [part.log for part in batch],
                "deployment": [part.deployment for part in batch],
                "copy": [part.copy for part in batch],
                "step": [part.start for part in batch],
                "episode_seed": [part.seed for part in batch],
            }
        )
        if self._episodes is None:
            self._episodes = _begin(self._root / "meta" / "episodes" / _file(0), table.schema)
        self._episodes.write_table(table)

    def close(self) -> None:
        for writer in (self._data, self._episodes):
            if writer is not None:
                writer.close()
        meta = self._root / "meta"
        pq.write_table(_tasks(self._view.team.env_id), meta / "tasks.parquet")
        (meta / "stats.json").write_text(json.dumps(self._statistics.to_dict(), indent=2))
        info = {
            "codebase_version": "v3.0",
            "robot_type": self._view.team.env_id,
            "total_episodes": self._trajectories,
            "total_frames": self._frames,
            "total_tasks": 1,
            "chunks_size": _FILES_A_CHUNK,
            "data_files_size_in_mb": _FILE_MEGABYTES,
            "fps": _FPS,
            "splits": {"train": f"0:{self._trajectories}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": self._features,
        }
        (meta / "info.json").write_text(json.dumps(info, indent=2))


def _file(number: int) -> Path:
    chunk, file = divmod(number, _FILES_A_CHUNK)
    return Path(f"chunk-{chunk:03d}", f"file-{file:03d}.parquet")


def _begin(path: Path, schema: pa.Schema) -> pq.ParquetWriter:
    path.parent.mkdir(parents=True, exist_ok=True)
    return rows_writer(path, schema)


def _joined(parts: Sequence[Sequence[NDArray[Any]]], agents: Sequence[int]) -> NDArray[Any]:
    """Trajectories' arrays by agent, (T,) or (T, n) each, as one (sum of T, sum of n)."""
    columns = [np.concatenate([part[i] for part in parts]) for i in agents]
    return np.concatenate([column.reshape(len(column), -1) for column in columns], axis=1)


def _features(columns: Columns, view: View) -> dict[str, dict[str, Any]]:
    agents = [view.team.agents[i] for i in view.agents]
    seen = [f"{agent.name}.{i}" for agent in agents for i in range(agent.observation_size)]
    names = {
        "observation.state": seen,
        "next.observation.state": seen,
        "action": [f"{agent.name}.{i}" for agent in agents for i in range(agent.action_size)],
        "next.reward": [agent.name for agent in agents],
        "exploring": [agent.name for agent in agents],
    }
    return {
        name: {
            "dtype": str(values.dtype),
            "shape": [values.shape[1] if values.ndim > 1 else 1],
            "names": names.get(name),
        }
        for name, values in columns.items()
    }


def _tasks(task: str) -> pa.Table:
    """The one task, as pandas writes a frame with the index "task" and the column "task_index"."""
    described = [
        {"name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
        {"name": "task", "pandas_type": "unicode", "numpy_type": "object"},
    ]
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [{**one, "field_name": one["name"], "metadata": None} for one in described],
        "pandas_version": "2.0.0",
    }
    columns = {"task_index": np.zeros(1, np.int64), "task": [task]}
    return pa.table(columns, metadata={"pandas": json.dumps(pandas)})
