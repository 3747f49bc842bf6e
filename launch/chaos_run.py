"""A run that is disturbed: its launcher, resumed whenever it ends before the run does."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from otc_dist.bus.keys import HOST
from otc_dist.description.distances import FITS
from otc_dist.errors import UserError
from otc_dist.run_folder import RunFolder

from .run_record import RunRecord
from .supervisor import die_with_parent
from .vital_signs import ProcessState, Supervision

PATIENCE = 240.0  # seconds without a change, after which a run is stuck
LOOK = 0.02  # seconds between two looks
PHASES = ("offline", "deploying", "tuning", "between")
RESUMES = 5  # of a launcher in a row, without its processes coming up


class StuckError(Exception):
    """The run does not come to its end."""


class DisturbedRun:
    """The launcher of a run in `root`; leaving the context ends it."""

    def __init__(self, root: Path, arguments: Sequence[str]) -> None:
        self.folder = RunFolder(root)
        self._arguments = arguments
        self._launcher: subprocess.Popen[bytes] | None = None
        self._resumes = 0
        self._output = root.with_name(root.name + ".log")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        if self._launcher is not None and self._launcher.poll() is None:
            self._launcher.terminate()
            self._launcher.wait()
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
        try:
            RunRecord.read(self.folder)
        except UserError as error:
            raise StuckError(f"the launcher ended with {status} before the run: {error}") from None
        if self._resumes == RESUMES:
            raise StuckError(f"the launcher ends with status {status}, again and again")
        self._resumes += 1
        self._launch("--resume", str(self.folder.root))
        return False

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
        pids = [process.pid for process in self.processes.values()]
        self._launcher.send_signal(signal.SIGKILL)
        self._launcher.wait()
        deadline = time.monotonic() + PATIENCE
        while any(_runs(pid) for pid in pids):
            self._check(deadline, "its processes outlive the launcher")
            time.sleep(LOOK)

    @property
    def phases_ahead(self) -> tuple[str, ...]:
        """The phases that may still come."""
        return PHASES[1:] if self.folder.evaluation(0).exists() else PHASES

    def freeze_launcher(self, seconds: float) -> None:
        """SIGSTOP, and SIGCONT after a while."""
        assert self._launcher is not None
        self._launcher.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self._launcher.send_signal(signal.SIGCONT)

    @property
    def phase(self) -> str:
        """Where the run stands: one of PHASES."""
        processes = self.processes
        phases = {process.phase for name, process in processes.items() if name != HOST}
        if phases & {"offline", *FITS}:
            return "offline"
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
