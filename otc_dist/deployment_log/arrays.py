"""A whole log in memory: arrays for every agent, and tables for pandas."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.episodes import Episode, find_episodes
from otc_dist.deployment_log.extent import Extent
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.record import Rows
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Transitions

EXTRA = "pandas"  # of pyproject.toml


@dataclass(frozen=True)
class Log:
    """One deployment: T steps of E copies of the environment, as N = T E rows of every agent.

    Row t E + e is step t of copy e. All arrays have N rows.

    Attributes:
        path: of the file that was read.
        header: run, deployment, seed, description (TOML), team, copies, versions.
        extent: how much of the deployment there is; `partial` says it in words.
        policies: agent -> digest of the policy that acted; empty until the log is finished.
        agents: agent -> its observations, actions, rewards, next observations and ends.
        exploring: agent -> whether it explored, (N,).
        held: agent -> whether its answer came too late and its action before was held, (N,); empty
            where no clock was kept (deployment.rate_hz).
        late: whether what the step brought came late, (N,).
        steps: number of the lock-step, (N,).
        copies: number of the environment's copy, (N,).
        episodes: of each row the index in `episode_table`, (N,).
        episode_starts: whether a row is the first of its episode that is in the log, (N,).
        episode_table: all episodes with their seeds, lengths and returns by agent.
    """

    path: Path
    header: LogHeader
    extent: Extent
    policies: Mapping[str, str]
    agents: Mapping[str, Transitions]
    exploring: Mapping[str, Bool]
    held: Mapping[str, Bool]
    late: Bool
    steps: NDArray[np.int64]
    copies: NDArray[np.int64]
    episodes: NDArray[np.int64]
    episode_starts: Bool
    episode_table: list[Episode]

    @property
    def partial(self) -> str | None:
        """What keeps it from being the whole deployment, as `unfinished: 30 of 120 steps`, or None
        if nothing does.
        """
        return self.extent.shortfall

    def __len__(self) -> int:
        return len(self.steps)

    def to_pandas(self) -> Any:
        """A `pandas.DataFrame` with one row for each agent, step and copy, agent by agent.

        Columns: agent, step, copy, episode, episode_start, observation_0 .., action_0 .., reward,
        next_observation_0 .., terminated, truncated, exploring. Where agents differ in their sizes
        the smaller ones' further entries are missing (NaN).

        Raises:
            UserError: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise UserError(f"to_pandas needs more packages: {install(EXTRA)}") from None
        frames = [pd.DataFrame(self._columns(agent)) for agent in self.agents]
        return pd.concat(frames, ignore_index=True).astype({"agent": "category"})

    def _columns(self, agent: str) -> dict[str, object]:
        own = self.agents[agent]
        return {
            "agent": agent,
            "step": self.steps,
            "copy": self.copies,
            "episode": self.episodes,
            "episode_start": self.episode_starts,
            **_entries("observation", own.observations),
            **_entries("action", own.actions),
            "reward": own.rewards,
            **_entries("next_observation", own.next_observations),
            "terminated": own.terminated,
            "truncated": own.truncated,
            "exploring": self.exploring[agent],
        }


def read_log(path: str | Path) -> Log:
    """A deployment's log, finished or not, as arrays. What is read has passed its checksum.

    All of it is in memory then; `otc_dist.deployment_log.reader` reads step by step. No code that
    the file names is run.

    Args:
        path: `RUN/deployments/deployment_01.mcap`; an unfinished one's `.partial` may be left out.

    Raises:
        UserError: missing, no log, of a version that is not read, or damaged (what is whole of it
            is recovered by `python -m otc_dist.replay PATH --recover`).
    """
    with OpenLog(Path(path)) as log:
        parts = _Parts(log)
        table = find_episodes(parts.taken(), len(log.header.team.agents))
        policies = log.metadata(fmt.POLICIES) if log.finished else {}
    numbers, copies = np.concatenate(parts.steps), log.header.copies
    episodes = np.empty((len(numbers), copies), np.int64)
    starts = np.zeros((len(numbers), copies), np.bool_)
    for index, episode in enumerate(table):
        first = int(np.searchsorted(numbers, episode.start))
        episodes[first : first + episode.length, episode.copy] = index
        starts[first, episode.copy] = True
    exploring, held = np.concatenate(parts.exploring), np.concatenate(parts.held)
    names = log.header.team.names
    return Log(
        path=log.path,
        header=log.header,
        extent=log.extent,
        policies=policies,
        agents={name: Transitions.concatenate(parts.agents[i]) for i, name in enumerate(names)},
        exploring={name: exploring[:, i].repeat(copies) for i, name in enumerate(names)},
        held={name: column.repeat(copies) for name, column in zip(names, held.T, strict=False)},
        late=np.concatenate(parts.late).repeat(copies),
        steps=numbers.repeat(copies),
        copies=np.tile(np.arange(copies), len(numbers)),
        episodes=episodes.reshape(-1),
        episode_starts=starts.reshape(-1),
        episode_table=table,
    )


class _Parts:
    """What is kept of a log's blocks as they pass; at first that of an empty one."""

    def __init__(self, log: OpenLog) -> None:
        self._log, layout, none = log, log.layout, log.layout.rows(b"")
        self.steps = [none["step"].astype(np.int64)]
        self.exploring, self.held = [layout.exploring(none)], [layout.held(none)]
        self.late = [layout.late(none)]
        self.agents = [[layout.transitions(none, i)] for i in range(len(log.header.team.agents))]

    def taken(self) -> Iterator[Rows]:
        """The log's blocks, of which these are the parts afterwards."""
        layout = self._log.layout
        for rows in self._log.blocks():
            self.steps.append(rows["step"].astype(np.int64))
            self.exploring.append(layout.exploring(rows))
            self.held.append(layout.held(rows))
            self.late.append(layout.late(rows))
            for i, parts in enumerate(self.agents):
                parts.append(layout.transitions(rows, i))
            yield rows


def _entries(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    return {f"{name}_{entry}": values[:, entry] for entry in range(values.shape[1])}
