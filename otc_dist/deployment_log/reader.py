"""Read deployment logs, finished or not. What is read has passed its checksum."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from otc_dist.deployment_log import format as fmt
from otc_dist.deployment_log.episodes import Episode, find_episodes, from_json
from otc_dist.deployment_log.extent import Extent
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep, Transitions


@dataclass(frozen=True)
class LogSummary:
    """A log at a glance. `policies`: agent -> digest of the policy that acted; empty until the
    log is finished. `extent`: how much of the deployment there is. `times`: of the first and last
    step, ns since the epoch; None without steps.
    """

    path: Path
    header: LogHeader
    extent: Extent
    times: tuple[int, int] | None
    policies: dict[str, str] = field(default_factory=dict)
    episodes: list[Episode] = field(default_factory=list)

    @property
    def steps(self) -> int:
        """How many there are."""
        return self.extent.steps

    @property
    def end(self) -> int:
        """The number after that of the last step."""
        return self.extent.end


def read_header(path: Path) -> LogHeader:
    """The header of a log; `path` may lack the `.partial` of an unfinished one.

    Raises:
        UserError: missing, no MCAP file, of another profile or of a version that is not read.
        DamagedLogError: neither copy of the header is intact.
    """
    with OpenLog(path) as log:
        return log.header


def read_steps(path: Path, start: int = 0, stop: int | None = None) -> Iterator[JointStep]:
    """Steps start..stop-1, as far as the log has them; what lies before is not read.

    An unfinished log ends at its last complete step.

    Raises:
        UserError: as `read_header`.
        DamagedLogError: after the last step before the damage.
    """
    with OpenLog(path) as log:
        for rows in log.blocks(start, stop):
            yield from log.layout.steps(rows)


def read_transitions(
    path: Path, agent: str, start: int = 0, stop: int | None = None
) -> Transitions:
    """The transitions of one agent in steps start..stop-1, ordered by step, then by copy.

    Raises:
        UserError: as `read_steps`; the log has no such agent.
    """
    with OpenLog(path) as log:
        names = log.header.team.names
        if agent not in names:
            raise UserError(f"{path} has no agent {agent!r}; it has {', '.join(names)}")
        index = names.index(agent)
        parts = [log.layout.transitions(rows, index) for rows in log.blocks(start, stop)]
        return Transitions.concatenate(
            parts or [log.layout.transitions(log.layout.rows(b""), index)]
        )


def read_summary(path: Path) -> LogSummary:
    """Header, policies and episodes; for an unfinished log these are computed from its steps.

    Raises:
        UserError, DamagedLogError: as `read_steps`.
    """
    with OpenLog(path) as log:
        return summarise(log)


def check_whole(log: OpenLog) -> None:
    """Refuse what does not hold its whole deployment where all of it counts. Raises UserError."""
    if log.extent.shortfall is not None:
        raise UserError(f"{log.path} is {log.extent.shortfall}; the whole deployment is needed")


def summarise(log: OpenLog) -> LogSummary:
    """As `read_summary`, of a log that is open already."""
    if log.finished:
        policies = log.metadata(fmt.POLICIES)
        table = log.metadata(fmt.EPISODES).get("episodes", "")
        episodes = from_json(table, log.header, log.path)
    else:
        policies, episodes = {}, find_episodes(log.blocks(), len(log.header.team.agents))
    return LogSummary(log.path, log.header, log.extent, log.times(), policies, episodes)
