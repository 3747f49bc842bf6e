"""What is in a log, at a glance or in a part of it."""

import argparse
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from otc_dist.deployment_log.episodes import Episode
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import LogSummary, summarise
from otc_dist.replay.selection import Selection, select
from otc_dist.terminal.printable import printable, say
from otc_dist.transitions import Float64

_LABEL = 14  # characters


def run(arguments: argparse.Namespace) -> int:
    """Print a summary of each file, or of the part of it that is asked for."""
    for number, path in enumerate(arguments.files):
        if number:
            print()
        say(*_lines(arguments, path))
    return 0


def _lines(arguments: argparse.Namespace, path: Path) -> list[str]:
    with OpenLog(path) as log:
        summary = summarise(log)
        selection = select(arguments, summary)
        rows = [*_about(summary), *_policies(summary, selection)]
        if arguments.steps is None and arguments.episode is None:
            rows += _whole(summary, selection)
        else:
            rows += _part(log, summary, selection)
        if summary.header.timed:
            rows.append(("real time", _misses(log, selection)))
    return [str(summary.path), *(f"  {label:<{_LABEL}}{printable(text)}" for label, text in rows)]


def _about(summary: LogSummary) -> list[tuple[str, str]]:
    header = summary.header
    return [
        ("run", f"{header.run}, deployment {header.deployment}, seed {header.seed}"),
        ("state", _state(summary)),
        ("environment", f"{header.team.env_id}, {_count(header.copies, 'copy', 'copies')}"),
        ("description", header.description_digest),
        ("versions", ", ".join(f"{name} {version}" for name, version in header.versions.items())),
    ]


def _state(summary: LogSummary) -> str:
    extent = summary.extent
    state = extent.shortfall or ("recovered" if extent.recovered else "finished")
    if not (extent.finished or extent.recovered):
        state += "; killed, or still being written"
    if not summary.header.bound:
        state += f"; unbound (log version {summary.header.format_version})"
    return state


def _policies(summary: LogSummary, selection: Selection) -> list[tuple[str, str]]:
    rows = []
    for index in selection.indices(summary.header.team.names):
        agent = summary.header.team.agents[index]
        actions = f"{agent.choices} choices" if agent.choices else f"action {agent.action_size}"
        policy = summary.policies.get(agent.name, "not known")
        rows.append(
            (agent.name, f"observation {agent.observation_size}, {actions}, policy {policy}")
        )
    return rows


def _whole(summary: LogSummary, selection: Selection) -> list[tuple[str, str]]:
    ended = [episode for episode in summary.episodes if episode.terminated or episode.truncated]
    broken = sum(episode.terminated and episode.truncated for episode in ended)
    terminated = sum(episode.terminated for episode in ended) - broken
    counted = [episode for episode in ended if episode.whole]
    return [
        ("steps", f"{summary.steps:,} ({_transitions(summary.steps, summary)}){_when(summary)}"),
        (
            "episodes",
            f"{len(summary.episodes):,}: {terminated:,} terminated,"
            f" {len(ended) - terminated - broken:,} truncated,"
            f"{f' {broken:,} broken off,' if broken else ''}"
            f" {len(summary.episodes) - len(ended):,} cut short",
        ),
        ("returns", _spread(_team_returns(counted, selection.indices(summary.header.team.names)))),
        ("gaps", summary.extent.missing),
    ]


def _part(log: OpenLog, summary: LogSummary, selection: Selection) -> list[tuple[str, str]]:
    """What happened in the selected steps; no others are read."""
    names = summary.header.team.names
    copies = slice(None) if selection.copy is None else slice(selection.copy, selection.copy + 1)
    sums, largest = np.zeros(len(names)), np.zeros(len(names))
    steps = terminated = truncated = 0
    for rows in log.blocks(selection.start, selection.stop):
        steps += len(rows)
        terminated += int(rows["terminated"][:, copies].sum())
        truncated += int(rows["truncated"][:, copies].sum())
        for index in selection.indices(names):
            sums[index] += rows[f"rewards.{index}"][:, copies].sum(dtype=np.float64)
            actions = np.abs(rows[f"actions.{index}"][:, copies])
            largest[index] = max(largest[index], float(actions.max()))
    found = [("steps", f"{selection.start:,} to {selection.stop - 1:,}: {steps:,}")]
    if selection.episode is not None:
        episode = summary.episodes[selection.episode]
        found.append(("episode", f"{selection.episode}, copy {episode.copy}, seed {episode.seed}"))
    found.append(("ends", f"{terminated:,} terminated, {truncated:,} truncated"))
    for index in selection.indices(names):
        text = f"sum of rewards {sums[index]:,.2f}, largest action {largest[index]:.4g}"
        found.append((names[index], text))
    return found


def _misses(log: OpenLog, selection: Selection) -> str:
    """Which deadlines were missed in the selected steps."""
    names, steps, late = log.header.team.names, 0, 0
    held = np.zeros(len(names), np.int64)
    for rows in log.blocks(selection.start, selection.stop):
        steps += len(rows)
        held += log.layout.held(rows).sum(axis=0)
        late += int(log.layout.late(rows).sum())
    by_agent = ", ".join(f"{names[i]} {held[i]:,}" for i in selection.indices(names))
    return f"actions held: {by_agent}; observations late: {late:,}; of {steps:,} steps"


def _team_returns(episodes: Iterable[Episode], agents: Sequence[int]) -> Float64:
    """Mean over the agents of their returns, (episodes,)."""
    returns = [[episode.returns[index] for index in agents] for episode in episodes]
    mean: Float64 = np.array(returns, np.float64).reshape(-1, len(agents)).mean(axis=1)
    return mean


def _spread(values: Float64) -> str:
    if not len(values):
        return "no episode ended"
    low, high = f"{values.min():,.2f}", f"{values.max():,.2f}"
    return f"mean {values.mean():,.2f}, std {values.std():,.2f}, from {low} to {high}"


def _when(summary: LogSummary) -> str:
    if summary.times is None:
        return ""
    first, last = (nanoseconds / 1e9 for nanoseconds in summary.times)
    begun = datetime.fromtimestamp(first, UTC).isoformat(" ", "seconds").removesuffix("+00:00")
    return f", begun {begun} UTC, {last - first:,.1f} s"


def _transitions(steps: int, summary: LogSummary) -> str:
    return f"{_count(steps * summary.header.copies, 'transition', 'transitions')} per agent"


def _count(number: int, one: str, many: str) -> str:
    return f"{number:,} {one if number == 1 else many}"
