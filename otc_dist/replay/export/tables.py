"""Trajectories as Arrow tables: one row a transition, for the formats that are tables."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from otc_dist.replay.export.formats import View
from otc_dist.replay.export.trajectories import Trajectory

Columns = dict[str, NDArray[Any]]


def transition_columns(batch: Sequence[Trajectory], view: View) -> Columns:
    """<s, a, r, s'> with its ends and tags, named as the view has it.

    Of one agent: observation (T, O), action (T, A), reward (T,), next_observation (T, O),
    terminated, truncated, exploring (T,). Of the team: the agent's name and a dot before what is
    an agent's own, and the simulator's state (T, S) before the step, if it has one.
    """
    found: Columns = {}
    for i in view.agents:
        own = "" if view.agent is not None else f"{view.team.agents[i].name}."
        found[f"{own}observation"] = np.concatenate([part.observations[i] for part in batch])
        found[f"{own}action"] = np.concatenate([part.actions[i] for part in batch])
        found[f"{own}reward"] = np.concatenate([part.rewards[i] for part in batch])
        found[f"{own}next_observation"] = np.concatenate(
            [part.next_observations[i] for part in batch]
        )
        found[f"{own}exploring"] = np.concatenate([part.exploring[i] for part in batch])
    found["terminated"] = np.concatenate([part.terminated for part in batch])
    found["truncated"] = np.concatenate([part.truncated for part in batch])
    if view.agent is None and view.team.state_size:
        found["state"] = np.concatenate([part.state for part in batch])
    return found


def place_columns(batch: Sequence[Trajectory], first: int) -> Columns:
    """Where each row is from (T,): log (of those in export.json), deployment, copy, trajectory,
    episode_seed, step.

    Args:
        first: number of the first trajectory of the batch in the export.
    """
    lengths = [len(part) for part in batch]

    def repeated(values: Sequence[int]) -> NDArray[np.int64]:
        return np.repeat(np.array(values, np.int64), lengths)

    return {
        "log": repeated([part.log for part in batch]),
        "deployment": repeated([part.deployment for part in batch]),
        "copy": repeated([part.copy for part in batch]),
        "trajectory": repeated(range(first, first + len(batch))),
        "episode_seed": repeated([part.seed for part in batch]),
        "step": np.concatenate([part.start + np.arange(len(part)) for part in batch]),
    }


def to_table(columns: Columns, metadata: dict[str, str] | None = None) -> pa.Table:
    """As an Arrow table; vectors (T, n) become lists of fixed size."""
    return pa.table({name: _array(values) for name, values in columns.items()}, metadata=metadata)


def _array(values: NDArray[Any]) -> pa.Array:
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    if values.ndim == 1:
        return flat
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
