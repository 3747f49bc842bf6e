"""A run that is disturbed: its launcher, resumed whenever it ends before the run does."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from otc_dist.bus.keys import HOST
from otc_dist.description.distances import FITS
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

from ..plan.run_record import RunRecord
from ..show.process_states import ProcessState, Supervision
from ..supervise.supervisor import die_with_parent

PATIENCE = 600.0  # seconds without a change, as while updates are compiled, after which it is stuck
LOOK = 0.02  # seconds between two looks
# In the order in which a run first comes to them, but that the last deployments and tunings take
# turns, with what is "between" them. "start": of the launcher, and of the processes after the data.
WORKING = ("offline", "fits", "deploying", "tuning", "between")
PHASES = ("data", "compile", "start", *WORKING, "report")
_PREPARING = {  # by what the launcher starts beside the processes of a run
    "otc_dist.datasets": "data",
    "otc_dist.launch.run.compile": "compile",
    "otc_dist.report": "report",
}
RESUMES = 5  # of a launcher in a row, without its processes coming up


class StuckError(Exception):
    """The run does not come to its end."""


class DisturbedRun:
    """The launcher of a run in `root`, with a cache of its own; leaving the context ends it.

    A launcher that ends by itself before the run does is a failure.

    Args:
        forgiving: unless the fault is one with which the launcher may give up, as with a full disk;
            the run is resumed then.
    """

    def __init__(self, root: Path, arguments: Sequence[str], forgiving: bool = False) -> None:
        self.folder = RunFolder(root)
        self._arguments, self._forgiving = arguments, forgiving
        self._cache = root.with_name(root.name + "-cache")
        self._launcher: subprocess.Popen[bytes] | None = None
        self._resumes = 0
        self._output = root.with_name(root.name + ".log")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        if self._launcher is not None and self._launcher.poll() is None:
            self._launcher.terminate()
            self._launcher.wait()
        shutil.rmtree(self._cache, ignore_errors=True)
        if not any(failure):
            self._output.unlink(missing_ok=True)

    def start(self) -> None:
        """Begin the run."""
        self._launch(*self._arguments, "--out", str(self.folder.root))

    def _launch(self, *arguments: str) -> None:
        with self._output.open("ab") as sink:
            self._launcher = subprocess.Popen(
                [sys.executable, "-m", "otc_dist.launch", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=sink,
                env={**os.environ, "OTC_DIST_CACHE": str(self._cache)},
                preexec_fn=die_with_parent(),
            )

    @property
    def over(self) -> bool:
        """Whether the run is finished; a launcher that ended before that is started again."""
        assert self._launcher is not None
        status = self._launcher.poll()
        if status is None:
            return False
        if status == 0:
            return True
        if status != -signal.SIGKILL:  # which is ours
            if not self._forgiving or self._resumes == RESUMES:
                raise StuckError(f"the launcher ended by itself, {status}: {self._complaint()}")
            self._resumes += 1
        if self.folder.run_json.exists():
            self._launch("--resume", str(self.folder.root))
        else:  # it was killed before the run had begun
            self.start()
        return False

    def _complaint(self) -> str:
        """What the launcher said was wrong; else its last line."""
        lines = self._output.read_text(encoding="utf-8", errors="replace").splitlines()
        errors = [line for line in lines if line.startswith("error: ")]
        return (errors or lines or ["it printed nothing"])[-1]

    @property
    def processes(self) -> dict[str, ProcessState]:
        """How the processes are; empty while nobody knows."""
        supervision = Supervision.read(self.folder)
        assert self._launcher is not None
        if supervision is None or supervision.launcher != self._launcher.pid:
            return {}
        return supervision.processes

    def settle(self) -> bool:
        """Wait until all processes are up; False if the run is finished before."""
        deadline, before = time.monotonic() + PATIENCE, ""
        while not self.over:
            processes = self.processes
            if processes and all(process.health == "up" for process in processes.values()):
                self._resumes = 0
                return True
            if str(processes) != before:
                deadline, before = time.monotonic() + PATIENCE, str(processes)
            self._check(deadline, "its processes do not come up")
            time.sleep(LOOK)
        return False

    def wait(self, seconds: float) -> bool:
        """Wait for a while; False if the run is finished before."""
        end = time.monotonic() + seconds
        while not self.over:
            if time.monotonic() >= end:
                return True
            time.sleep(LOOK)
        return False

    def wait_for_phase(self, phase: str, seconds: float) -> bool:
        """Wait until the run is in `phase`, or for a while; False if it is finished before."""
        end = time.monotonic() + seconds
        while not self.over:
            if self.phase == phase or time.monotonic() >= end:
                return True
            time.sleep(LOOK)
        return False

    def wait_for_restart(self, name: str, restarts: int, seconds: float = PATIENCE) -> None:
        """Wait until a process has been started again more than `restarts` times."""
        deadline = time.monotonic() + seconds
        while not self.over:
            process = self.processes.get(name)
            if process is not None and process.restarts > restarts:
                return
            self._check(deadline, f"{name} is not started again")
            time.sleep(LOOK)

    def finish(self) -> None:
        """Wait for the run's end."""
        deadline, before = time.monotonic() + PATIENCE, ""
        while not self.over:
            if (now := str(self.processes)) != before:
                deadline, before = time.monotonic() + PATIENCE, now
            self._check(deadline, "it does not end")
            time.sleep(LOOK)

    def _check(self, deadline: float, what: str) -> None:
        if time.monotonic() > deadline:
            raise StuckError(f"{what} for {PATIENCE:.0f} s")

    def kill_launcher(self) -> None:
        """SIGKILL; the kernel ends its children with it."""
        assert self._launcher is not None
        pids = [*self._children(), *(process.pid for process in self.processes.values())]
        self._launcher.send_signal(signal.SIGKILL)
        self._launcher.wait()
        deadline = time.monotonic() + PATIENCE
        while any(_runs(pid) for pid in pids):
            self._check(deadline, "its processes outlive the launcher")
            time.sleep(LOOK)

    @property
    def phases_ahead(self) -> tuple[str, ...]:
        """The phases that may still come."""
        if self.folder.evaluation(0).exists():
            return PHASES[PHASES.index("deploying") :]
        if not self.processes:  # a launcher that starts may yet prepare anything
            return PHASES
        return PHASES[2:] if self.phase == "start" else PHASES[3:]

    def preparing(self) -> tuple[str, int] | None:
        """What the launcher does beside the run's processes, "data", "compile" or "report", and by
        which process.
        """
        for pid, command in self._children().items():
            for module, phase in _PREPARING.items():
                if module in command:
                    return phase, pid
        return None

    def _children(self) -> dict[int, list[str]]:
        """The launcher's processes: id -> command line."""
        assert self._launcher is not None
        found = {}
        try:
            own = Path(f"/proc/{self._launcher.pid}/task/{self._launcher.pid}/children").read_text()
        except OSError:  # it has ended
            return {}
        for pid in map(int, own.split()):
            with contextlib.suppress(OSError):
                line = Path(f"/proc/{pid}/cmdline").read_bytes()
                found[pid] = line.decode(errors="replace").split("\0")
        return found

    def freeze_launcher(self, seconds: float) -> None:
        """SIGSTOP, and SIGCONT after a while."""
        assert self._launcher is not None
        self._launcher.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self._launcher.send_signal(signal.SIGCONT)

    @property
    def _worked(self) -> bool:
        """Whether all is done but the report, and perhaps that too."""
        with contextlib.suppress(UserError):  # the run has not begun
            return RunRecord.read(self.folder).state in ("reporting", "finished")
        return False

    @property
    def phase(self) -> str:
        """Where the run stands: one of PHASES."""
        if preparing := self.preparing():
            return preparing[0]
        processes = self.processes
        if not processes and self._worked:
            return "report"
        if not processes or any(process.phase == "starting" for process in processes.values()):
            return "start"
        phases = {process.phase for name, process in processes.items() if name != HOST}
        if "offline" in phases:
            return "offline"
        if phases & {*FITS}:
            return "fits"
        if "tuning" in phases:
            return "tuning"
        host = processes.get(HOST)
        return "deploying" if host is not None and host.phase == "deployment" else "between"


def _runs(pid: int) -> bool:
    """Whether a process still runs, and is not only waiting for its parent to note its end."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return state.rpartition(")")[2].split()[0] != "Z" and os.getpid() != pid
