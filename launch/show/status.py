"""`launch status RUN`: where a run stands, and how its processes are."""

import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from otc_dist.bus.messages import Status
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.amounts import duration
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import aligned, say

from ..plan import run_record
from ..plan.run_record import RunRecord
from .approve import waiting, waiting_lines
from .board import describe_phase
from .process_states import ProcessState, Supervision

_LATE = 5.0  # seconds without a word of the launcher's, after which it is said


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.launch status",
        description="Where a run stands, and how each of its processes is: from any terminal, while"
        " the run goes or after it.",
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the run's folder")
    parser.add_argument("--json", action="store_true", help="for programs")
    return parser


def main(argv: list[str]) -> int:
    """Print it. Returns the exit status.

    Raises:
        UserError: not a run's folder, or a damaged one.
    """
    arguments = command_line().parse_args(argv)
    folder = RunFolder(arguments.run.resolve())
    record = RunRecord.read(folder)
    launched = _launched(folder)
    state: str = record.state
    if state in ("running", "reporting") and not launched:
        state = "interrupted"
    supervision = Supervision.read(folder) if launched else None
    if arguments.json:
        awaited = waiting(folder) if launched else None
        report = {
            "run": record.run,
            "state": state,
            "started": record.started,
            "finished": record.finished,
            "waiting": awaited and asdict(awaited),
            "supervision": supervision and asdict(supervision),
        }
        print(json.dumps(report, indent=1))
    else:
        say(*_lines(folder, state, supervision))
    return 0


def _launched(folder: RunFolder) -> bool:
    """Whether a launcher is at work there."""
    held = run_record.launched(folder)
    if held is not None:
        return held
    supervision = Supervision.read(folder)
    # No lock says so. Before its processes are started, nothing would.
    return supervision is None or _silence(supervision) <= _LATE


def _silence(supervision: Supervision) -> float:
    """Seconds since the launcher's last word."""
    return (datetime.now(UTC) - datetime.fromisoformat(supervision.written)).total_seconds()


def _lines(folder: RunFolder, state: str, supervision: Supervision | None) -> Iterator[str]:
    yield f"{folder.root}: {state}"
    if state in ("stopped", "failed", "interrupted"):
        yield f"continue with: python -m otc_dist.launch --resume {folder.root}"
    if supervision is None:
        return
    yield from waiting_lines(folder)
    if (silence := _silence(supervision)) > _LATE:
        yield f"the launcher (process {supervision.launcher}) has said nothing for {silence:.0f} s"
    if supervision.seconds_left is not None:
        yield f"about {duration(supervision.seconds_left)} to go"
    yield from _table(supervision.processes, shutil.get_terminal_size().columns)


def _table(processes: Mapping[str, ProcessState], width: int) -> Iterator[str]:
    """A line each, and below it how one ended that began again; in `width` characters, for which
    the least informative columns are left out.
    """
    states = list(processes.values())
    columns = {
        "process": list(processes),
        "pid": [str(state.pid) for state in states],
        "health": [state.health for state in states],
        "restarts": [str(state.restarts) for state in states],
        "does": [
            describe_phase(Status(name, s.phase, s.deployment)) for name, s in processes.items()
        ],
        "done": [f"{s.done:,}/{s.of:,}" if s.of else "" for s in states],
    }
    if not any(state.restarts for state in states):
        del columns["restarts"]
    for spare in ("", "pid", "restarts", "health"):
        columns.pop(spare, None)
        lines = aligned([tuple(columns), *zip(*columns.values(), strict=True)])
        if max(map(len, lines)) <= width:
            break
    ends = ["", *(state.last_end for state in states)]
    for line, end in zip(lines, ends, strict=True):
        yield line
        if end:
            yield f"  its last end: {end}"
