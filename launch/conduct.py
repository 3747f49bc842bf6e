"""Conducts a run: data, compilation, processes, live view, report, and a clear end of any kind."""

import queue
import shlex
import shutil
import sys
import time
from collections.abc import Mapping

from otc_dist.bus.keys import HOST
from otc_dist.bus.messages import Status
from otc_dist.datasets.card import FILE_NAME as CARD

from . import descriptions
from .board import Board
from .closing import closing_lines
from .forecast import Remaining
from .observer import observing
from .plan import Plan
from .run_record import RunRecord
from .signals import Signals
from .supervisor import End, Supervisor
from .view import View, open_view

REFRESH = 0.5  # seconds between two looks at the statuses
FAREWELL = 30.0  # seconds that the learners may take to end after the host has


class _StoppedError(Exception):
    """The user, or the system, asked the launcher to stop."""


class _DiedError(Exception):
    """A process ended that should not have."""

    def __init__(self, end: End) -> None:
        super().__init__(end.process)
        self.end = end


def conduct(plan: Plan, record: RunRecord) -> int:
    """Run `plan` from wherever its folder stands to its end. Returns the exit status.

    0: finished; 1: a process died; 2: a process met a mistake that the user can mend;
    128 + n: stopped by signal n. In every case no process is left, and unless it finished,
    the way to go on is printed.
    """
    go_on = f"resume with: python -m otc_dist.launch --resume {shlex.quote(str(plan.folder.root))}"
    title = plan.description.name
    if record.quick:
        title += f" ({descriptions.QUICK_LABEL})"
    print(f"{title}: {plan.folder.root}", flush=True)
    with Signals() as signals:
        try:
            with Supervisor(signals) as supervisor:
                _complete(plan, plan.preparations, supervisor, signals)
                shutil.copyfile(plan.data_folder / CARD, plan.folder.dataset_card)
                with open_view(title) as view:
                    _run(plan, record, supervisor, signals, view)
                record.moved_to("finished", plan.folder)
                _complete(plan, plan.conclusions, supervisor, signals)
            print("\n".join(closing_lines(plan.folder)))
        except _StoppedError:
            assert signals.stop is not None
            record.moved_to("stopped", plan.folder)
            print(f"stopped by {signals.stop.name}; {go_on}")
            return 128 + signals.stop
        except _DiedError as died:
            record.moved_to("failed", plan.folder)
            _explain(died.end)
            print(go_on)
            return 2 if died.end.status == 2 else 1
    return 0


def _complete(
    plan: Plan, commands: Mapping[str, tuple[str, ...]], supervisor: Supervisor, signals: Signals
) -> None:
    """Run commands one after the other, each to a good end, showing their progress."""
    for name, command in commands.items():
        supervisor.start(name, command, plan.folder.output(name), show_errors=True)
        while name in supervisor.running:
            if signals.stop:
                raise _StoppedError
            signals.wait(REFRESH)
            for end in supervisor.ended():
                if end.status != 0:
                    raise _DiedError(end)


def _run(
    plan: Plan, record: RunRecord, supervisor: Supervisor, signals: Signals, view: View
) -> None:
    """Start all processes and show them until all have ended well."""
    for process in plan.processes:
        supervisor.start(process.name, process.command, plan.folder.output(process.name))
    board = Board(plan.spec.names, Remaining(plan.parts))
    statuses: queue.SimpleQueue[Status] = queue.SimpleQueue()
    over: float | None = None  # when the host ended
    with observing(plan, record.run, statuses.put):
        while supervisor.running:
            signals.wait(REFRESH)
            while not statuses.empty():
                board.take(statuses.get(), time.monotonic())
            view.show(board)
            if signals.stop:
                raise _StoppedError
            for end in supervisor.ended():
                if end.status != 0:
                    raise _DiedError(end)
                if end.process == HOST:
                    over = time.monotonic()
            if over is not None and time.monotonic() > over + FAREWELL:
                names = ", ".join(supervisor.running)
                view.say(f"{names} did not end {FAREWELL:.0f} s after the host: stopped")
                supervisor.stop()


def _explain(end: End) -> None:
    lines = end.last_lines()
    if lines and lines[-1].startswith("error: "):  # it could say itself what was wrong
        print(f"error: {end.process}: {lines[-1].removeprefix('error: ')}", file=sys.stderr)
        return
    print(f"error: {end.process} {end.manner}; all others were stopped", file=sys.stderr)
    if lines:
        print(f"its last lines ({end.output}):", file=sys.stderr)
        for line in lines:
            print(f"  {line}", file=sys.stderr)
