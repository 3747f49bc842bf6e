"""`python -m otc_dist.replay FILE... --export FORMAT --out PATH`: PATH is a folder of data sets."""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import otc_dist
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.reader import LogSummary, read_header, summarise
from otc_dist.deployment_log.several import in_order
from otc_dist.replay.export.disk_space import require_room
from otc_dist.replay.export.formats import FORMATS, Format, View
from otc_dist.replay.export.trajectories import Trajectory, trajectories
from otc_dist.replay.output import claimed, note_shortfall
from otc_dist.replay.selection import Selection, select
from otc_dist.spec import TeamSpec
from otc_dist.system import durable
from otc_dist.terminal import progress
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say

CARD = "export.json"  # says what is in the folder
_BATCH = 65_536  # transitions that are written at once


@dataclass(frozen=True)
class _Part:
    """What of a log is exported."""

    summary: LogSummary
    selection: Selection

    @property
    def copies(self) -> int:
        return self.summary.header.copies if self.selection.copy is None else 1

    @property
    def transitions(self) -> int:
        """How many there are, if no steps are missing."""
        return (self.selection.stop - self.selection.start) * self.copies

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


def run(arguments: argparse.Namespace) -> int:
    """Export the selected part of the logs, joined; all of it is written, or nothing."""
    if arguments.out is None:
        raise UserError("--export needs --out PATH, the folder to make")
    form = FORMATS[arguments.export]
    form.opener()  # a library that is missing is told before anything is read
    headers = {path: read_header(path) for path in arguments.files}
    parts = [_part(path, arguments) for path in in_order(headers)]
    _check_replaceable(arguments.out)
    with claimed(arguments.out, force=arguments.force) as folder:
        folder.mkdir()
        card = _export(folder, parts, form, arguments)
        for path in (*folder.rglob("*"), folder):
            durable.sync(path)
    say(
        f"{arguments.out}: {arguments.export}, {', '.join(card['data_sets'])};"
        f" {card['transitions']:,} transitions in {card['trajectories']:,} trajectories"
    )
    return 0


def _part(path: Path, arguments: argparse.Namespace) -> _Part:
    with OpenLog(path) as log:
        summary = summarise(log)
    note_shortfall(summary)
    return _Part(summary, select(arguments, summary))


def _check_replaceable(out: Path) -> None:
    """That `--force` takes away an earlier export at most, and never a folder of something else."""
    if out.is_dir() and any(out.iterdir()) and not (out / CARD).exists():
        raise UserError(f"{out} is a folder with something else in it: choose another --out")


def _export(
    folder: Path, parts: Sequence[_Part], form: Format, arguments: argparse.Namespace
) -> dict[str, Any]:
    """Write all data sets and the card; returns the card."""
    team = parts[0].summary.header.team
    logs = [part.about() for part in parts]
    about = json.dumps({"environment": team.env_id, "logs": logs})
    views = _views(team, parts[0].selection, form, about)
    writers = [form.opener()(folder, view) for view in views]
    total, done, count = sum(part.transitions for part in parts), 0, 0
    with progress.shown(f"exporting to {arguments.out}", "transitions") as report:
        for batch in _batches(parts):
            require_room(folder, form, batch)
            for writer in writers:
                writer.write(batch)
            count += len(batch)
            done += sum(map(len, batch))
            report(done, max(total, done))
    if not done:
        raise UserError(f"{arguments.files[0]}: there is no whole step to export")
    for writer in writers:
        writer.close()
    card = {
        "format": arguments.export,
        "environment": team.env_id,
        "data_sets": [view.name for view in views],
        "transitions": done,
        "trajectories": count,
        "logs": logs,
        "otc_dist": otc_dist.__version__,
    }
    (folder / CARD).write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    return card


def _views(team: TeamSpec, selection: Selection, form: Format, about: str) -> list[View]:
    """A data set for each selected agent, and one of all where the format has room for it."""
    views = [View(team, index, about) for index in selection.indices(team.names)]
    whole = len(views) == len(team.agents) > 1
    return [*views, View(team, None, about)] if whole and form.joint else views


def _batches(parts: Sequence[_Part]) -> Iterator[list[Trajectory]]:
    batch: list[Trajectory] = []
    rows = 0
    for number, part in enumerate(parts):
        with OpenLog(part.summary.path) as log:
            for trajectory in trajectories(log, part.selection, number):
                batch.append(trajectory)
                rows += len(trajectory)
                if rows >= _BATCH:
                    yield batch
                    batch, rows = [], 0
    if batch:
        yield batch
