"""Read deployment logs as a data set: what a team did, to train from logs alone."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from otc_dist.datasets.card import file_sha256
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.recording import numbers
from otc_dist.deployment_log.extent import scheduled_steps
from otc_dist.deployment_log.format import PARTIAL_SUFFIX, DamagedLogError, existing
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.record import RecordLayout, Rows
from otc_dist.deployment_log.salvage import Salvage
from otc_dist.deployment_log.seeds import OwnSteps
from otc_dist.deployment_log.several import in_order
from otc_dist.envs import registry
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.progress import Report, silent
from otc_dist.transitions import Bool, Transitions, choice_problem

_SUFFIXES = (".mcap", f".mcap{PARTIAL_SUFFIX}")


@dataclass(frozen=True)
class Logged:
    """The steps of some deployments of one team, in the order of run, deployment and step."""

    team: TeamSpec
    runs: tuple[str, ...]  # sorted
    data: JointTransitions  # one row per step and copy
    begun: Bool  # (T,) whether the row's episode is there from its first step
    recipe: dict[str, str]  # "RUN deployment K" -> SHA-256 of the file
    notes: tuple[str, ...]  # what is missing


@dataclass(frozen=True)
class _File:
    path: Path
    header: LogHeader
    agents: tuple[Transitions, ...]
    episodes: NDArray[np.int64]  # (T,) from 0
    begun: Bool  # (T,)
    notes: tuple[str, ...]


def is_log(path: Path) -> bool:
    """Whether that is a deployment log, or is one by its name."""
    if path.name.endswith(_SUFFIXES):
        return True
    try:
        with path.open("rb") as file:
            return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
    except OSError:
        return False


def read_logs(paths: Sequence[Path], report: Report = silent) -> Logged:
    """Join logs of one environment. Of an unfinished or damaged one, every whole step is taken.

    Steps in which the simulator broke off (both terminated and truncated) did not happen, and are
    left out.

    Args:
        report: called with (logs read, of how many).

    Raises:
        UserError: no log, of different environments, of an environment that is not known or has
            other agents now, the same deployment twice, or bad values.
    """
    found = {}
    for number, path in enumerate(paths, 1):
        found[path] = _read(path)
        report(number, len(paths))
    files = [found[path] for path in in_order({path: file.header for path, file in found.items()})]
    team = files[0].header.team
    starts = np.cumsum([0, *(file.episodes.max(initial=-1) + 1 for file in files[:-1])])
    agents = [
        Transitions.concatenate([file.agents[index] for file in files])
        for index in range(len(team.agents))
    ]
    data = JointTransitions(
        observations=tuple(agent.observations for agent in agents),
        actions=tuple(agent.actions for agent in agents),
        rewards=tuple(agent.rewards for agent in agents),
        next_observations=tuple(agent.next_observations for agent in agents),
        terminated=agents[0].terminated,
        truncated=agents[0].truncated,
        episodes=np.concatenate(
            [file.episodes + start for file, start in zip(files, starts, strict=True)]
        ),
    )
    return Logged(
        team,
        tuple(sorted({file.header.run for file in files})),
        data,
        np.concatenate([file.begun for file in files]),
        {f"{f.header.run} deployment {f.header.deployment}": file_sha256(f.path) for f in files},
        tuple(note for file in files for note in file.notes),
    )


def _read(path: Path) -> _File:
    path = existing(path)
    try:
        with OpenLog(path) as log:
            header, layout, own = log.header, log.layout, OwnSteps(log.header)
            rows = _joined(layout, own.of(log.blocks()))
            notes: tuple[str, ...] = ()
            if log.extent.shortfall is not None:
                notes = (f"{path.name} is {log.extent.shortfall}",)
    except DamagedLogError as error:
        with Salvage(path) as salvage:
            header, layout, own = salvage.header, salvage.layout, OwnSteps(salvage.header)
            rows = _joined(layout, own.of(salvage.blocks()))
        reason = str(error).replace(str(path), path.name)
        of = scheduled_steps(header)
        many = f"{len(rows):,} steps" if of is None else f"{len(rows):,} of {of:,} steps"
        notes = (f"{reason}; {many} in it are whole",)
    _check_team(header.team, path)
    if not header.bound:
        unbound = f"log version {header.format_version}, unbound to its run"
        notes += (f"{path.name}: {unbound}{f'; {own.in_words}' if own.in_words else ''}",)
    episodes, begun = _numbered(rows["step"], rows["terminated"] | rows["truncated"])
    agents = [layout.transitions(rows, index) for index in range(len(header.team.agents))]
    broken = agents[0].terminated & agents[0].truncated
    if broken.any():
        kept = np.flatnonzero(~broken)
        agents = [agent[kept] for agent in agents]
        episodes, begun = episodes[kept], begun[kept]
        notes += (f"{path.name}: without {int(broken.sum())} steps whose simulator broke off",)
    for spec, agent in zip(header.team.agents, agents, strict=True):
        _check_values(agent, spec.choices, f"{path}: {spec.name}")
    return _File(path, header, tuple(agents), episodes, begun, notes)


def _joined(layout: RecordLayout, blocks: Iterable[Rows]) -> Rows:
    return np.concatenate([layout.rows(b""), *blocks])


def _numbered(steps: NDArray[np.unsignedinteger], ends: Bool) -> tuple[NDArray[np.int64], Bool]:
    """Which episode each row belongs to, in order of their starts, and whether that has its start.

    Args:
        steps: (T,) ascending; where one is missing, whatever follows counts as another episode.
        ends: (T, E) whether an episode ended with that step.

    Returns:
        both (T * E,), by step, then by copy.
    """
    gaps = np.diff(steps.astype(np.int64), prepend=-1) != 1  # some step before this one is missing
    starts = np.ones(ends.shape, np.bool_)
    starts[1:] = ends[:-1] | gaps[1:, np.newaxis]
    counted = np.cumsum(starts.reshape(-1)).reshape(ends.shape) - 1
    numbers = np.maximum.accumulate(np.where(starts, counted, 0), axis=0).reshape(-1)
    begun: Bool = ~np.broadcast_to(gaps[:, np.newaxis], ends.shape)[starts]
    return numbers, begun[numbers]


def _check_team(team: TeamSpec, path: Path) -> None:
    if not registry.known(team.env_id):
        raise UserError(f"{path} was recorded in {team.env_id}, which this otc_dist does not have")
    try:
        now = registry.team_spec(team.env_id)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    if now.agents != team.agents:
        raise UserError(
            f"{path}: {team.env_id} had other agents when it was recorded, "
            f"{_interfaces(team)} instead of {_interfaces(now)}"
        )


def _interfaces(team: TeamSpec) -> str:
    return ", ".join(f"{a.name} ({a.observation_size}, {a.action_size})" for a in team.agents)


def _check_values(data: Transitions, choices: int, source: str) -> None:
    for name in ("observations", "actions", "rewards", "next_observations"):
        array = getattr(data, name)
        numbers(array, name, array.shape, source)
    if problem := choice_problem(data, choices):
        raise UserError(f"{source}: {problem}")
