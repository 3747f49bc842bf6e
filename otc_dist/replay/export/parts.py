"""What is exported: the selected part of each log, or a data set from the cache."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from otc_dist.datasets import store
from otc_dist.datasets.card import DatasetCard
from otc_dist.datasets.names import DatasetName
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import LogSummary, read_header, summarise
from otc_dist.deployment_log.several import in_order
from otc_dist.envs import registry
from otc_dist.replay.export.trajectories import Trajectory, trajectories
from otc_dist.replay.output import note_shortfall
from otc_dist.replay.selection import Selection, chosen_agents, select
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError


class Part(Protocol):
    """One log, or a data set."""

    @property
    def team(self) -> TeamSpec: ...

    @property
    def agents(self) -> tuple[str, ...]:
        """Who was selected."""
        ...

    @property
    def transitions(self) -> int:
        """How many there are, if no steps are missing."""
        ...

    def about(self) -> dict[str, object]:
        """Where they come from, for `export.json`."""
        ...

    def trajectories(self, number: int) -> Iterator[Trajectory]:
        """In their order; `number` is the part's."""
        ...


def parts_of(arguments: argparse.Namespace) -> tuple[str, Sequence[Part]]:
    """What `export.json` calls the parts, "logs" or "data_set", and the parts.

    Raises:
        UserError: no such log, data set, agent or steps.
    """
    name = _data_set(arguments.files)
    if name is None:
        if arguments.transitions is not None:
            raise UserError("--transitions is a data set's size; of a log, choose --steps")
        headers = {path: read_header(path) for path in arguments.files}
        return "logs", [_log(path, arguments) for path in in_order(headers)]
    for flag in ("steps", "episode"):
        if getattr(arguments, flag) is not None:
            raise UserError(f"--{flag} is for logs; all of {name} is exported")
    card = store.cached(str(name), arguments.transitions or 0)
    # A set has no states of the simulator.
    team = replace(registry.team_spec(name.env_id), state_size=0)
    return "data_set", [_Set(card, team, chosen_agents(arguments, team.names, str(name)))]


def _data_set(files: Sequence[Path]) -> DatasetName | None:
    """The data set that is named where logs could be. Raises UserError: there is no such one."""
    if len(files) > 1 or files[0].exists() or not registry.known(str(files[0].parent)):
        return None
    return DatasetName.parse(str(files[0]))


def _log(path: Path, arguments: argparse.Namespace) -> "_Log":
    with OpenLog(path) as log:
        summary = summarise(log)
    note_shortfall(summary)
    return _Log(summary, select(arguments, summary))


@dataclass(frozen=True)
class _Log:
    summary: LogSummary
    selection: Selection

    @property
    def team(self) -> TeamSpec:
        return self.summary.header.team

    @property
    def agents(self) -> tuple[str, ...]:
        return self.selection.agents

    @property
    def transitions(self) -> int:
        copies = self.summary.header.copies if self.selection.copy is None else 1
        return (self.selection.stop - self.selection.start) * copies

    def about(self) -> dict[str, object]:
        header, extent = self.summary.header, self.summary.extent
        return {
            "file": self.summary.path.name,
            "run": header.run,
            "deployment": header.deployment,
            "seed": header.seed,
            "description_digest": header.description_digest,
            "finished": extent.finished,
            "whole": extent.whole,
            "held": extent.count,
            "steps": [self.selection.start, self.selection.stop],
            "policies": self.summary.policies,
            "versions": dict(header.versions),
        }

    def trajectories(self, number: int) -> Iterator[Trajectory]:
        with OpenLog(self.summary.path) as log:
            yield from trajectories(log, self.selection, number)


@dataclass(frozen=True)
class _Set:
    card: DatasetCard
    team: TeamSpec
    agents: tuple[str, ...]

    @property
    def transitions(self) -> int:
        return self.card.transitions

    def about(self) -> dict[str, object]:
        return self.card.model_dump(mode="json")

    def trajectories(self, number: int) -> Iterator[Trajectory]:
        """Its episodes; of which deployment and copy they were, and their seeds, nobody knows."""
        data = store.load_joint(self.card.name, self.card.transitions)
        order = np.argsort(data.episodes, kind="stable")
        starts = np.flatnonzero(np.diff(data.episodes[order])) + 1
        for rows in np.split(order, starts):
            episode = data[rows]
            nobody = np.zeros(len(rows), np.bool_)
            yield Trajectory(
                log=number,
                deployment=0,
                copy=0,
                seed=0,
                start=0,
                observations=episode.observations,
                actions=episode.actions,
                rewards=episode.rewards,
                next_observations=episode.next_observations,
                terminated=episode.terminated,
                truncated=episode.truncated,
                exploring=(nobody,) * len(self.team.agents),
                state=np.zeros((len(rows), 0)),
            )
