"""`python -m otc_dist.replay FILE... --export FORMAT --out PATH`: PATH is a folder of data sets."""

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import otc_dist
from otc_dist.replay.export.disk_space import require_space
from otc_dist.replay.export.formats import FORMATS, Format, View
from otc_dist.replay.export.parts import Part, parts_of
from otc_dist.replay.export.trajectories import Trajectory
from otc_dist.replay.output import claimed
from otc_dist.spec import TeamSpec
from otc_dist.system import durable
from otc_dist.terminal import progress
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say

CARD = "export.json"  # says what is in the folder
_BATCH = 65_536  # transitions that are written at once


def run(arguments: argparse.Namespace) -> int:
    """Export the selected part of the logs, joined, or a data set; all is written, or nothing."""
    if arguments.out is None:
        raise UserError("--export needs --out PATH, the folder to make")
    form = FORMATS[arguments.export]
    form.opener()  # a library that is missing is reported before anything is read
    kind, parts = parts_of(arguments)
    out, force, reads = arguments.out, arguments.force, arguments.files
    with claimed(out, force=force, reads=reads, marker=CARD) as folder:
        folder.mkdir()
        card = _export(folder, {kind: [part.about() for part in parts]}, parts, form, arguments)
        for path in (*folder.rglob("*"), folder):
            durable.sync(path)
    say(
        f"{arguments.out}: {arguments.export}, {', '.join(card['data_sets'])};"
        f" {card['transitions']:,} transitions in {card['trajectories']:,} trajectories"
    )
    return 0


def _export(
    folder: Path,
    origin: Mapping[str, object],
    parts: Sequence[Part],
    form: Format,
    arguments: argparse.Namespace,
) -> dict[str, Any]:
    """Write all data sets and the card; returns the card."""
    team = parts[0].team
    about = json.dumps({"environment": team.env_id, **origin})
    views = _views(team, parts[0].agents, form, about)
    writers = [form.opener()(folder, view) for view in views]
    total, done, count = sum(part.transitions for part in parts), 0, 0
    with progress.shown(f"exporting to {arguments.out}", "transitions") as report:
        for batch in _batches(parts):
            require_space(folder, form, batch)
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
        **origin,
        "otc_dist": otc_dist.__version__,
    }
    (folder / CARD).write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    return card


def _views(team: TeamSpec, agents: Sequence[str], form: Format, about: str) -> list[View]:
    """A data set for each selected agent, and one of all where the format has room for it."""
    views = [View(team, team.index(agent), about) for agent in agents]
    whole = len(views) == len(team.agents) > 1
    return [*views, View(team, None, about)] if whole and form.joint else views


def _batches(parts: Sequence[Part]) -> Iterator[list[Trajectory]]:
    batch: list[Trajectory] = []
    rows = 0
    for number, part in enumerate(parts):
        for trajectory in part.trajectories(number):
            batch.append(trajectory)
            rows += len(trajectory)
            if rows >= _BATCH:
                yield batch
                batch, rows = [], 0
    if batch:
        yield batch
