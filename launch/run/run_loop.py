"""Runs a plan: data, compilation, processes, live view, report, and a clear end of any kind."""

import queue
import shlex
import shutil
import sys
import time
from collections.abc import Mapping
from contextlib import suppress

from otc_dist.bus.keys import HOST
from otc_dist.bus.messages import Status
from otc_dist.datasets import inputs
from otc_dist.datasets.card import FILE_NAME as CARD
from otc_dist.envs import registry
from otc_dist.system.processor import libraries
from otc_dist.terminal.errors import UserError, os_error_line
from otc_dist.terminal.printable import say

from ..plan import descriptions
from ..plan.artifacts import damaged_checkpoints
from ..plan.forecast import Remaining
from ..plan.keep import check_rewards
from ..plan.ledger import Ledger
from ..plan.new_folder import NewFolder
from ..plan.plan import Plan
from ..plan.run_record import RunRecord
from ..show.approve import waiting_lines
from ..show.board import TRAINING, Board
from ..show.process_states import SupervisionFile
from ..show.summary import show_summary
from ..show.view import View, open_view
from ..supervise.observer import Sign, Waiting, nobody_of_run, observing
from ..supervise.processes import (
    MISTAKE,
    STOPPED,
    DiedError,
    RunProcesses,
    StoppedByFileError,
)
from ..supervise.signals import Signals
from ..supervise.supervisor import Supervisor
from .companions import Companions
from .one_off import StoppedError, run_one_off

REFRESH = 0.5  # seconds between two looks at the statuses
FAREWELL = 30.0  # seconds that the learners may take to end after the host has


def run_plan(plan: Plan, record: RunRecord, new: NewFolder | None = None) -> int:
    """Run `plan` from wherever its folder stands to its end. Returns the exit status.

    Args:
        new: its folder, if the run begins: it is taken away if it meets a mistake before anything
            in it took work. Otherwise the run can be gone on with.

    0: finished; 1: a process died; 2: a process met a mistake that the user can fix;
    3: a person stopped a deployment in real time by a file; 128 + n: stopped by signal n.
    In every case no process is left, and unless it finished, the way to go on is printed.
    """
    go_on = f"resume with: python -m otc_dist.launch --resume {shlex.quote(str(plan.folder.root))}"
    title = plan.description.name
    if record.quick:
        title += f" ({descriptions.QUICK_LABEL})"
    say(f"{title}: {plan.folder.root}")
    strangers = nobody_of_run(plan, record.run)
    met = (plan.placement.meeting, plan.placement.missing or strangers)
    for line in filter(None, (*met, plan.beside.address)):
        say(line)
    for remark in registry.remarks(plan.description.env.id):
        print(f"{plan.description.env.id}: {remark}", flush=True)
    ledger = Ledger(record, plan.folder)
    with Signals() as signals:
        try:
            with Companions(plan.beside, plan.folder, signals) as companions:
                with Supervisor(signals) as supervisor:
                    if record.state != "reporting":  # else all is done but the report
                        _work(plan, ledger, supervisor, signals, title, companions)
                        ledger.enter("reporting")
                    _do(plan, plan.conclusions, supervisor, signals)
                    ledger.enter("finished")
                if plan.conclusions:
                    _close(plan, title)
                else:
                    print(f"{title}: finished; the env host has the results")
        except StoppedError:
            assert signals.stop is not None
            ledger.enter("stopped")
            print(f"stopped by {signals.stop.name}; {go_on}")
            return 128 + signals.stop
        except StoppedByFileError as stopped:
            ledger.enter("stopped")
            say(f"{stopped}; {go_on}")
            return STOPPED
        except UserError:
            if not (new and new.take_away()):
                ledger.enter("failed")
            raise
        except OSError as error:
            with suppress(OSError):
                ledger.enter("failed")
            raise UserError(f"{os_error_line(error)}; {go_on}") from None
        except DiedError as died:
            if not died.explained:
                _explain(died)
            mistake = died.end.status == MISTAKE
            if not (mistake and new and new.take_away()):
                ledger.enter("failed")
                print(go_on)
            return MISTAKE if mistake else 1
        finally:
            plan.placement.leave(plan.folder.root)
    return 0


def _close(plan: Plan, title: str) -> None:
    """Print the last lines of a run that is finished, whatever becomes of that."""
    try:
        show_summary(plan.folder)
    except Exception as error:  # what they say is in the report as well
        print(f"{title}: finished ({type(error).__name__}: {error}); report: {plan.folder.report}")


def _work(
    plan: Plan,
    ledger: Ledger,
    supervisor: Supervisor,
    signals: Signals,
    title: str,
    companions: Companions,
) -> None:
    """Prepare and run the processes, until they have made all that they are to make.

    Raises:
        UserError: other inputs than it began with; or a checkpoint is damaged that nobody can make
            again now.
    """
    description, folder = plan.description, plan.folder
    ledger.note_inputs(inputs.sources(description) | inputs.code(description), description)
    _do(plan, plan.preparations, supervisor, signals)
    ledger.note_inputs(inputs.data(description, plan.learners), description)
    if plan.placement.role == "all":
        check_rewards(description, plan.learners)
    if plan.data_folder is not None:
        shutil.copyfile(plan.data_folder / CARD, folder.dataset_card)
    with open_view(title) as view:
        _run(plan, ledger, supervisor, signals, view, companions)
        # Learners read what they have written before they leave; the disk may damage it later.
        if damage := damaged_checkpoints(folder, description, plan.placement, plan.learners):
            if plan.placement.role != "all":
                raise UserError(
                    f"{damage[0][0]}, and the env host has ended, without whose log it cannot be"
                    " made again: resume the run on all hosts"
                )
            view.say(f"{damage[0][0]}; it and what follows are made again")
            for path in (path for _, paths in damage for path in paths):
                path.unlink(missing_ok=True)
            _run(plan, ledger, supervisor, signals, view, companions)


def _do(
    plan: Plan, commands: Mapping[str, tuple[str, ...]], supervisor: Supervisor, signals: Signals
) -> None:
    """Run commands side by side, each to a good end, showing their progress."""
    run_one_off(commands, plan.folder.output, supervisor, signals, plan.patience)


def _run(
    plan: Plan,
    ledger: Ledger,
    supervisor: Supervisor,
    signals: Signals,
    view: View,
    companions: Companions,
) -> None:
    """Start all processes, and again those that die, and show them until all have ended well."""
    processes = RunProcesses(plan, supervisor)
    board = Board(plan.watched, Remaining(plan.parts), processes.health.of_process)
    signs: queue.SimpleQueue[Sign | Waiting] = queue.SimpleQueue()
    over: float | None = None  # when the host ended
    known = set[int]()  # processes whose libraries are noted
    asked: list[str] = []  # what has been said of the approval that is awaited

    def notice(sign: Sign | Waiting) -> None:
        signs.put(sign)
        if not isinstance(sign, Status):  # these come often, and can wait
            signals.wake()

    with (
        observing(plan, ledger.record.run, notice),
        SupervisionFile(plan.folder) as supervision_file,
    ):
        while processes.at_work:
            processes.start_due()
            signals.wait(REFRESH)
            while not signs.empty():
                sign = signs.get()
                if isinstance(sign, Waiting):
                    if not board.over:  # else nobody is awaited any more
                        view.say(sign.line)
                    continue
                processes.take(sign)
                if isinstance(sign, Status):
                    board.take(sign, time.monotonic())
                    process = processes.health.of_process.get(sign.process)
                    if process and process.pid not in known and sign.phase in TRAINING:
                        known.add(process.pid)
                        ledger.note_libraries(libraries(process.pid))
            if signals.stop:
                raise StoppedError
            finished = processes.look()
            board.events += processes.drain_events() + companions.events()
            if board.newest.get(HOST, Status(HOST)).phase in ("approval", "reset"):
                # Not by the phase between two: a short deployment may be over before it is seen.
                lines = waiting_lines(plan.folder)
                board.events += lines if lines != asked else []
                asked = lines
            view.show(board)
            supervision_file.write(board)
            if HOST in finished and over is None:
                over = time.monotonic()
            if over is not None and time.monotonic() > over + FAREWELL:
                names = ", ".join(supervisor.running)
                view.say(f"{names} did not end {FAREWELL:.0f} s after the host: stopped")
                supervisor.stop()
                return


def _explain(died: DiedError) -> None:
    end, lines = died.end, died.end.last_lines()
    if lines and lines[-1].startswith("error: "):  # it could say itself what was wrong
        say(f"error: {end.process}: {lines[-1].removeprefix('error: ')}", file=sys.stderr)
        return
    again = f", also after {died.restarts} restarts" if died.restarts else ""
    say(f"error: {end.process} {died.manner}{again}; all others were stopped", file=sys.stderr)
    if lines:
        say(f"its last lines ({end.output}):", file=sys.stderr)
        for line in lines:
            say(f"  {line}", file=sys.stderr)
