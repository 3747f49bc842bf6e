"""What a run leaves, as bytes: all that must not depend on what happened on the way."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from otc_dist.deployment_log.reader import read_steps, read_summary
from otc_dist.description import Description
from otc_dist.report.files import Record
from otc_dist.report.results import results, to_json
from otc_dist.report.run_data import read_run
from otc_dist.report.run_page import render
from otc_dist.run.folder import RunFolder
from otc_dist.transitions import JointStep

# Of run.json and of the report: what distinguishes one run of a description from another.
_OWN = ("run", "command", "started", "finished", "resumed")


def outcome(folder: RunFolder) -> dict[str, bytes]:
    """A digest of every file that a run has left, of what in it must be the same; of what the
    processes printed, that there is such a file.

    Raises:
        OSError, UserError, ValueError: something is missing or damaged.
    """
    found = {"report of what there is": _report(folder)}
    for path in sorted(folder.root.rglob("*")):
        if path.is_dir():
            continue
        name = path.relative_to(folder.root).as_posix()
        found[name] = next(read(path) for end, read in _READERS if name.endswith(end))
    _check_current(folder)
    return found


def differences(ours: Mapping[str, bytes], theirs: Mapping[str, bytes]) -> list[str]:
    """What differs, or is there in one only."""
    return sorted(
        name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)
    )


def _report(folder: RunFolder) -> bytes:
    """The report and its numbers, but for whose they are and how long it took."""
    run = read_run(folder)
    fields = {name: value for name, value in run.record.items() if name not in _OWN}
    record = cast(Record, fields)
    record["run"] = "a run"  # else it is called as its folder is
    # Where the processes meet is part of the description, and is not the same for every fault.
    description = run.description.with_assignments("bus.router=''")
    masked = replace(run, record=record, description=description, wall_seconds=None)
    return _digest(to_json(results(masked)) + render(masked))


def _check_current(folder: RunFolder) -> None:
    """Raises ValueError if the report is not that of what the folder holds."""
    run = read_run(folder)
    for path, text in ((folder.results, to_json(results(run))), (folder.report, render(run))):
        if path.read_text(encoding="utf-8") != text:
            raise ValueError(f"{path.name} is not that of what the run has left")


def _digest(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()


def _json(path: Path, *without: str) -> bytes:
    fields: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return _digest(
        json.dumps({k: v for k, v in fields.items() if k not in without}, sort_keys=True)
    )


def _record(path: Path) -> bytes:
    return _json(path, "description", "place", *_OWN)


def _host(path: Path) -> bytes:
    return _json(path, "epoch")


def _description(path: Path) -> bytes:
    description = Description.load(path)
    return _digest(description.with_assignments("bus.router=''").to_toml())


def _metrics(path: Path) -> bytes:
    """Of each place in training the last line, but for when it was written."""
    last: dict[tuple[object, ...], object] = {}
    for text in path.read_text(encoding="utf-8").splitlines():
        line = json.loads(text)
        place = (line["phase"], line["deployment"], line["update"])
        last[place] = (line["updates"], line["metrics"])
    return _digest(repr(sorted(last.items())))


def _log(path: Path) -> bytes:
    """How many steps, every bit of each, and what stands beside them, but for the time."""
    digest, count = hashlib.sha256(), 0
    for step in read_steps(path):
        count += 1
        for part in _arrays(step):
            digest.update(np.asarray(part).tobytes())
    summary = read_summary(path)
    policies, episodes = sorted(summary.policies.items()), [asdict(e) for e in summary.episodes]
    beside = (count, summary.extent.whole, policies, episodes)
    return _digest(repr(beside)) + digest.digest()


def _arrays(step: JointStep) -> Iterator[object]:
    for field in fields(JointStep):
        value = getattr(step, field.name)
        yield from value if isinstance(value, tuple) else (value,)


def _whole(path: Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).digest()


def _there(path: Path) -> bytes:
    return b"there"


# By how a path ends; the first that fits.
_READERS: tuple[tuple[str, Callable[[Path], bytes]], ...] = (
    ("run.json", _record),
    ("host.json", _host),
    ("description.toml", _description),
    ("metrics.jsonl", _metrics),
    (".mcap", _log),
    ("results.json", _there),  # see `_report`
    ("report.html", _there),
    (".log", _there),
    (".lock", _there),
    ("", _whole),
)
