"""`--verify`: whether a log is whole, and whether what it says comes out again, to the bit."""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from otc_dist.deployment_log.container import check_container
from otc_dist.deployment_log.episodes import find_episodes
from otc_dist.deployment_log.extent import Extent
from otc_dist.deployment_log.format import DamagedLogError
from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import LogSummary, summarise
from otc_dist.deployment_log.seeds import SeedCheck
from otc_dist.description import Description
from otc_dist.replay import replayed_episodes
from otc_dist.replay.policies import check_policies
from otc_dist.replay.selection import Selection, select
from otc_dist.system.processor import kind
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say
from otc_dist.terminal.progress import shown
from otc_dist.transitions import JointStep

# Exit statuses, the worst first; 0: everything that could be checked holds to the bit.
FAILED, UNBOUND, APPROXIMATE = 1, 4, 3
_SHOWN = 5  # differences
_SIGNS = {0: "ok", FAILED: "WRONG", UNBOUND: "unbound", APPROXIMATE: "close", None: "-"}

Finding = tuple[int | None, str]  # a status and a sentence; None: there was nothing to check
Steps = Callable[[], Iterator[JointStep]]


def run(arguments: argparse.Namespace) -> int:
    """Check each file and print what was found; the worst status."""
    statuses: set[int | None] = {0}
    for path in arguments.files:
        say(path)
        for status, text in _findings(arguments, path):
            say(f"  {_SIGNS[status]:<5} {text}")
            statuses.add(status)
    return next(status for status in (FAILED, UNBOUND, APPROXIMATE, 0) if status in statuses)


def _findings(arguments: argparse.Namespace, path: Path) -> Iterator[Finding]:
    try:
        with OpenLog(path) as log:
            summary = summarise(log)
            selection = select(arguments, summary)
            yield _integrity(log)
            yield _binding(log.header, accept=arguments.accept_unbound)
            yield _sequence(summary)
            yield _length(summary.extent)
            yield _episodes(log, summary)
            yield _seeds(log, selection)
            yield from _processor(log.header)
            yield from _simulation(log, _steps(log, selection, f"{path.name}: playing it again"))
            steps = _steps(log, selection, f"{path.name}: acting again")
            yield from _description(summary, selection, steps)
    except DamagedLogError as error:
        yield FAILED, f"{error}; --recover writes what is whole to another file"


def _steps(log: OpenLog, selection: Selection, doing: str) -> Steps:
    """What gives the selected steps, with progress."""

    def steps() -> Iterator[JointStep]:
        total, done = selection.stop - selection.start, 0
        with shown(doing, "steps") as report:
            for rows in log.blocks(selection.start, selection.stop):
                for step in log.layout.steps(rows):
                    yield step
                    done += 1
                    report(done, max(total, done))

    return steps


def _integrity(log: OpenLog) -> Finding:
    steps = sum(len(rows) for rows in log.blocks())
    if not log.finished:
        return 0, f"checksums of {steps:,} steps; it is unfinished, so there are no others"
    return 0, f"checksums of {steps:,} steps, of {check_container(log)} chunks, of the file"


def _binding(header: LogHeader, *, accept: bool) -> Finding:
    if header.bound:
        return 0, f"every step is of run {header.run}, deployment {header.deployment}"
    text = (
        f"log version {header.format_version}: its checksums do not say whether a step is of"
        " another run, deployment or description"
    )
    return (0, f"unbound, as accepted: {text}") if accept else (UNBOUND, text)


def _processor(header: LogHeader) -> Iterator[Finding]:
    """What to think of differences that follow, where the log was written on another kind."""
    there, here = header.versions.get("processor"), kind()
    if there is not None and there != here:
        yield None, f"written on {there}, and this is {here}: what they round differently differs"


def _sequence(summary: LogSummary) -> Finding:
    if summary.extent.gaps:
        return FAILED, f"{summary.extent.missing} are missing"
    return 0, f"steps 0 to {summary.end - 1:,} without a gap"


def _description(summary: LogSummary, selection: Selection, steps: Steps) -> Iterator[Finding]:
    """What depends on the whole description, which another version may have written."""
    try:
        description = Description.parse(summary.header.description)
    except UserError as error:
        yield None, f"its policies, since its description is not understood: {error}"
        return
    indices = selection.indices(summary.header.team.names)
    for verdict in check_policies(summary, description, indices, steps):
        status = None if verdict.holds is None else 0 if verdict.holds else FAILED
        yield status, f"{verdict.agent}: {verdict.text}"


def _length(extent: Extent) -> Finding:
    if extent.scheduled is None:
        return None, "its length, which its description does not give"
    if extent.whole:
        return 0, f"as many as its description asks for: {extent.scheduled:,}"
    failed = (extent.finished or extent.recovered) and not extent.complete
    status = FAILED if failed else None  # of an unfinished one the rest may come
    return status, f"{extent.shortfall} that its description asks for"


def _episodes(log: OpenLog, summary: LogSummary) -> Finding:
    if not log.finished:
        return None, "it is unfinished, so there is no table of episodes"
    if find_episodes(log.blocks(), len(log.header.team.agents)) != summary.episodes:
        return FAILED, "its table of episodes is not that of its steps"
    return 0, f"table of {len(summary.episodes):,} episodes and their returns"


def _seeds(log: OpenLog, selection: Selection) -> Finding:
    check, count, first = SeedCheck(log.header), 0, ""
    for rows in log.blocks(selection.start, selection.stop):
        places = np.argwhere(check.wrong(rows))
        if len(places) and not count:
            first = f"step {rows['step'][places[0, 0]]:,}, copy {places[0, 1]}"
        count += len(places)
    if count:
        return FAILED, (
            f"{first}: the episode's seed is not one that the run's seed gives there;"
            f" {_transitions(count)} of such episodes"
        )
    return 0, "seeds of all episodes: those that the run's seed gives"


def _transitions(count: int) -> str:
    return f"{count:,} {'transition' if count == 1 else 'transitions'}"


def _simulation(log: OpenLog, steps: Steps) -> Iterator[Finding]:
    if log.header.timed:  # to make its environment and reset it would move somebody's robots
        yield None, "its episodes are not played again: they were played in real time"
        return
    env = replayed_episodes.simulator(log)
    try:
        if others := replayed_episodes.other_versions(log, env):
            yield _one_step(replayed_episodes.one_step_errors(steps, env), others)
            return
        found = replayed_episodes.compare(log.header, steps(), env)
    finally:
        env.close()
    if not found.differences:
        yield (
            0,
            f"{found.episodes:,} episodes played again, {found.steps:,} steps: every observation,"
            " reward and end, to the bit",
        )
    for difference in found.differences[:_SHOWN]:
        where = f"step {difference.step:,}, copy {difference.copy}"
        yield FAILED, f"played again, {where}: {difference.what} differs"
    if (more := len(found.differences) - _SHOWN) > 0:
        yield FAILED, f"{more:,} more of {found.episodes:,} episodes differ"


def _one_step(errors: replayed_episodes.OneStepErrors, others: list[str]) -> Finding:
    exact = not (errors.observations.any() or errors.rewards.any() or errors.ends)
    median, most, largest = np.percentile(errors.observations, (50, 95, 100))
    return (
        0 if exact else APPROXIMATE,
        f"another simulator ({', '.join(others)}): {len(errors.observations):,} single steps from"
        f" the logged states; observations are off by {median:.2g} standard deviations (median),"
        f" {most:.2g} (95%), {largest:.2g} (most), rewards by {errors.rewards.max():.2g} at most,"
        f" {errors.ends:,} ends differ",
    )
