"""Which part of a log is asked for: `--steps`, `--episode` and `--agent`."""

import argparse
from dataclasses import dataclass

from otc_dist.deployment_log.reader import LogSummary
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class Selection:
    """Steps start..stop-1 of some agents, in all copies or in one."""

    start: int
    stop: int
    agents: tuple[str, ...]
    copy: int | None = None
    episode: int | None = None

    def indices(self, names: tuple[str, ...]) -> list[int]:
        """The agents' places in the team whose names are `names`."""
        return [names.index(agent) for agent in self.agents]


def step_range(text: str) -> tuple[int, int | None]:
    """The type of `--steps`: "100:200", "100:" or ":200". Raises ArgumentTypeError."""
    first, colon, last = text.partition(":")
    try:
        start, stop = int(first or 0), int(last) if last else None
        if not colon or start < 0 or (stop is not None and stop <= start):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a range of steps such as 100:200"
        ) from None
    return start, stop


def chosen_agents(
    arguments: argparse.Namespace, names: tuple[str, ...], source: str
) -> tuple[str, ...]:
    """Those of `names` that `--agent` asks for. UserError: `source` has none of that name."""
    for agent in arguments.agent or ():
        if agent not in names:
            raise UserError(f"{source} has no agent {agent!r}; it has {', '.join(names)}")
    return tuple(name for name in names if not arguments.agent or name in arguments.agent)


def select(arguments: argparse.Namespace, summary: LogSummary) -> Selection:
    """What the command line asks for, in this log.

    Raises:
        UserError: the log has no such episode, agent or steps.
    """
    agents = chosen_agents(arguments, summary.header.team.names, str(summary.path))
    start, stop, copy = 0, summary.end, None
    if arguments.episode is not None:
        if not 0 <= arguments.episode < len(summary.episodes):
            raise UserError(
                f"{summary.path} has no episode {arguments.episode}; it has"
                f" {len(summary.episodes)}, counted from 0"
            )
        episode = summary.episodes[arguments.episode]
        start, stop, copy = episode.start, episode.start + episode.length, episode.copy
    if arguments.steps is not None:
        low, high = arguments.steps
        start, stop = max(start, low), stop if high is None else min(stop, high)
        if start >= stop:
            raise UserError(
                f"{summary.path} has no steps {low}:{'' if high is None else high} to show;"
                f" it ends with step {summary.end - 1}"
            )
    return Selection(start, stop, agents, copy, arguments.episode)
