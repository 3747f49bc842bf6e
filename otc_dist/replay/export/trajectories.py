"""What is exported: trajectories, in the order of their ends, however the log's copies mix them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.record import Rows
from otc_dist.replay.selection import Selection
from otc_dist.transitions import Bool, Float32, Float64


@dataclass(frozen=True)
class Trajectory:
    """T consecutive steps of one episode of one copy: all of it, unless the log or what was asked
    for begins or ends within it, or lacks steps. Tuples are by agent, arrays by step.
    """

    log: int  # which of the exported logs it is from, from 0
    deployment: int
    copy: int
    seed: int  # of the episode
    start: int  # number of its first step in the deployment
    observations: tuple[Float32, ...]  # N x (T, observation_size)
    actions: tuple[Float32, ...]  # N x (T, action_size)
    rewards: tuple[Float32, ...]  # N x (T,)
    next_observations: tuple[Float32, ...]  # N x (T, observation_size), the true successors s'
    terminated: Bool  # (T,)
    truncated: Bool  # (T,)
    exploring: tuple[Bool, ...]  # N x (T,)
    state: Float64  # (T, state_size) of the simulator, before the step

    def __len__(self) -> int:
        return len(self.terminated)

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        by_agent = (
            *self.observations,
            *self.actions,
            *self.rewards,
            *self.next_observations,
            *self.exploring,
        )
        return sum(x.nbytes for x in (*by_agent, self.terminated, self.truncated, self.state))


# A stretch of one copy's steps: the columns of `_columns`, each with T rows.
_Columns = dict[str, NDArray[Any]]


def trajectories(log: OpenLog, selection: Selection, number: int) -> Iterator[Trajectory]:
    """The trajectories of the selected part of log `number`, in the order of their ends.

    No more of the log is held than the trajectories that have not ended.

    Raises:
        DamagedLogError: after the trajectories that ended before the damage.
    """
    copies = range(log.header.copies) if selection.copy is None else (selection.copy,)
    waiting: dict[int, list[_Columns]] = {copy: [] for copy in copies}
    expected = selection.start
    for rows in log.blocks(selection.start, selection.stop):
        steps = rows["step"].astype(np.int64)
        gaps = np.flatnonzero(np.diff(steps, prepend=expected - 1) != 1)  # before these rows
        expected = int(steps[-1]) + 1
        columns = _columns(log, rows)
        ends = rows["terminated"] | rows["truncated"]
        # (row after the trajectory's last, copy): of gaps, all copies' trajectories end.
        cuts = sorted(
            {(int(gap), copy) for gap in gaps for copy in copies}
            | {(int(row) + 1, copy) for copy in copies for row in np.flatnonzero(ends[:, copy])}
        )
        begun = dict.fromkeys(copies, 0)
        for row, copy in cuts:
            if row > begun[copy]:
                waiting[copy].append(_part(columns, copy, begun[copy], row))
            if waiting[copy]:
                yield _joined(log, number, copy, waiting[copy])
                waiting[copy] = []
            begun[copy] = row
        for copy in copies:
            if begun[copy] < len(rows):
                waiting[copy].append(_part(columns, copy, begun[copy], len(rows)))
    for copy in copies:
        if waiting[copy]:
            yield _joined(log, number, copy, waiting[copy])


def _columns(log: OpenLog, rows: Rows) -> _Columns:
    """What a trajectory is made of, by step, then by copy."""
    agents, copies = len(log.header.team.agents), log.header.copies
    names = [
        f"{name}.{agent}"
        for name in ("observations", "actions", "rewards", "next_observations")
        for agent in range(agents)
    ]
    columns = {
        name: np.array(rows[name])
        for name in (*names, "terminated", "truncated", "state", "episode_seeds")
    }
    exploring = log.layout.exploring(rows)
    for agent in range(agents):
        columns[f"exploring.{agent}"] = np.repeat(exploring[:, agent : agent + 1], copies, axis=1)
    columns["step"] = np.repeat(rows["step"].astype(np.int64)[:, np.newaxis], copies, axis=1)
    return columns


def _part(columns: _Columns, copy: int, start: int, stop: int) -> _Columns:
    return {name: array[start:stop, copy] for name, array in columns.items()}


def _joined(log: OpenLog, number: int, copy: int, parts: list[_Columns]) -> Trajectory:
    one = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def by_agent(name: str) -> tuple[NDArray[Any], ...]:
        return tuple(one[f"{name}.{agent}"] for agent in range(len(log.header.team.agents)))

    return Trajectory(
        log=number,
        deployment=log.header.deployment,
        copy=copy,
        seed=int(one["episode_seeds"][0]),
        start=int(one["step"][0]),
        observations=by_agent("observations"),
        actions=by_agent("actions"),
        rewards=by_agent("rewards"),
        next_observations=by_agent("next_observations"),
        terminated=one["terminated"],
        truncated=one["truncated"],
        exploring=by_agent("exploring"),
        state=one["state"],
    )
