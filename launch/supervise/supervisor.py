"""Starts processes, notices their ends, stops them, and leaves none behind."""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from .signals import Signals

GRACE = 10.0  # seconds between SIGTERM and SIGKILL
_PR_SET_PDEATHSIG = 1

# One thread each: several learners share the cores, and results do not depend on their number.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
# What glibc may keep of memory that was freed. Left alone, it raises both bounds as it goes, and a
# learner holds tens of megabytes that it once needed; lower ones cost time at every update.
FRUGAL = {"MALLOC_TRIM_THRESHOLD_": str(16 * 2**20), "MALLOC_MMAP_THRESHOLD_": str(4 * 2**20)}
SETTINGS = {**ONE_THREAD, **FRUGAL, "PYTHONUNBUFFERED": "1"}  # of every process's environment


@dataclass(frozen=True)
class End:
    """How a process ended: `status` as in subprocess (negative: killed by that signal)."""

    process: str
    status: int
    output: Path | None

    @property
    def manner(self) -> str:
        """In words: `exited with status 1`, `was killed by SIGKILL`."""
        if self.status >= 0:
            return f"exited with status {self.status}"
        return f"was killed by {signal.Signals(-self.status).name}"

    def last_lines(self, count: int = 15) -> list[str]:
        """What it printed last."""
        if self.output is None or not self.output.exists():
            return []
        return self.output.read_text(encoding="utf-8", errors="replace").splitlines()[-count:]


@dataclass(frozen=True)
class _Child:
    handle: subprocess.Popen[bytes]
    output: Path | None


class Supervisor:
    """The processes of one launcher. Leaving its context stops whatever still runs.

    Each is the leader of its own process group, so that a Ctrl-C at the terminal reaches only
    the launcher, which then stops them in order, and so that a stop reaches their children too.
    On Linux the kernel kills them when the launcher dies, however it dies.
    """

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._running: dict[str, _Child] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.stop()

    @property
    def running(self) -> tuple[str, ...]:
        """Names of the processes that have not ended, in the order of their starts."""
        return tuple(self._running)

    def start(
        self,
        name: str,
        command: Sequence[str],
        output: Path | None = None,
        show_errors: bool = False,
    ) -> None:
        """Start a process; what it prints is appended to `output` (None: shown as it comes).

        `show_errors`: its standard error, where progress is reported, is shown as it comes.

        Must be called from the main thread: the kernel's death signal is tied to the thread.
        """
        sink = None
        if output is not None:
            output.parent.mkdir(parents=True, exist_ok=True)
            sink = output.open("ab")
        try:
            handle = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=None if sink is None or show_errors else subprocess.STDOUT,
                env={**os.environ, **SETTINGS},
                process_group=0,
                preexec_fn=die_with_parent(),
            )
        finally:
            if sink is not None:
                sink.close()
        self._running[name] = _Child(handle, output)

    def pid(self, name: str) -> int:
        """The process id of a running process."""
        return self._running[name].handle.pid

    def kill(self, name: str) -> None:
        """SIGKILL to a running process and to what it started; its end shows in `ended`."""
        _signal_group(self._running[name].handle.pid, signal.SIGKILL)

    def ended(self) -> list[End]:
        """The processes that ended since the last call."""
        ends = []
        for name, child in list(self._running.items()):
            status = child.handle.poll()
            if status is not None:
                del self._running[name]
                _signal_group(child.handle.pid, signal.SIGKILL)  # whatever it started itself
                ends.append(End(name, status, child.output))
        return ends

    def stop(self) -> list[End]:
        """SIGTERM to all, last started first; SIGKILL after GRACE seconds, or if asked twice."""
        for child in reversed(self._running.values()):
            _signal_group(child.handle.pid, signal.SIGTERM)
        ends: list[End] = []
        deadline = time.monotonic() + GRACE
        while self._running and time.monotonic() < deadline and not self._signals.repeated:
            ends += self.ended()
            if self._running:
                self._signals.wait(0.2)
        for child in self._running.values():
            _signal_group(child.handle.pid, signal.SIGKILL)
            child.handle.wait()
        return ends + self.ended()


def _signal_group(leader: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):  # all of it has ended already
        os.killpg(leader, number)


def die_with_parent() -> Callable[[], None] | None:
    """What a child does between fork and exec: ask the kernel to end it with its parent.

    None where the kernel does not offer that.
    """
    if sys.platform != "linux":
        return None
    parent = os.getpid()
    prctl = ctypes.CDLL(None, use_errno=True).prctl  # looked up before the fork

    def arrange() -> None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # the launcher died before the line above
            os._exit(1)

    return arrange
