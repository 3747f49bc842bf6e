"""The faults: what each does to a run, once, at a time that others choose."""

import contextlib
import errno
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Self

from otc_dist.bus.keys import HOST
from otc_dist.run_folder import RunFolder

from .chaos_arena import Arena
from .chaos_run import DisturbedRun
from .supervisor import die_with_parent
from .vital_signs import ProcessState

_TCP = "tcp/127.0.0.1:7447"
# A router as anybody may run one: nothing of this package's settings.
_ROUTER = """
import sys, threading, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["{sys.argv[1]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config):
    threading.Event().wait()
"""


class MissedError(Exception):
    """There was nothing to strike at this time."""


@dataclass(frozen=True)
class Place:
    """Where runs are disturbed."""

    out: Path
    arena: Arena

    def room(self, fault: "Fault") -> Path:
        """The folder for runs that `fault` strikes."""
        return self.arena.small if isinstance(fault, FullDisk) else self.out


class Fault:
    """One kind of fault. Used as a context manager around a run."""

    flags: tuple[str, ...] = ()  # of the launcher
    impossible = ""  # why it cannot be had here

    def __init__(self, place: Place) -> None:
        self.arena = place.arena

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        pass

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        """Raises MissedError if there is nothing to strike now."""
        raise NotImplementedError


class KillHost(Fault):
    """SIGKILL to the env host."""

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        _kill(run, HOST)


class KillLearner(Fault):
    """SIGKILL to one of the learners."""

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        _kill(run, _victim(run, numbers, learners_only=True)[0])


class KillLauncher(Fault):
    """SIGKILL to the launcher; its processes end with it, and it is resumed."""

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        run.kill_launcher()


class Freeze(Fault):
    """SIGSTOP to a process: half of them go on after a while, the others are found and killed.

    One in five times it is the launcher, which always goes on.
    """

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        if numbers.random() < 0.2:
            run.freeze_launcher(numbers.uniform(0.1, 5.0))
            return
        name, process = _victim(run, numbers)
        _send(process.pid, signal.SIGSTOP)
        if numbers.random() < 0.5:
            run.wait(numbers.uniform(0.1, 4.0))
            _send(process.pid, signal.SIGCONT)
        else:
            run.wait_for_restart(name, process.restarts)


class CorruptCheckpoint(Fault):
    """A learner's newest checkpoint is damaged while it is down."""

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        name, process = _victim(run, numbers, learners_only=True)
        if _newest_checkpoint(run.folder, name) is None:
            raise MissedError
        _send(process.pid, signal.SIGSTOP)  # so that the newest stays the newest
        try:
            newest = _newest_checkpoint(run.folder, name)
            assert newest is not None  # a newer one replaces an older one
            if not newest.stat().st_size:  # emptied the last time, and not made again yet
                raise MissedError
            _damage(newest, numbers)
        finally:
            _send(process.pid, signal.SIGKILL)
        run.wait_for_restart(name, process.restarts)


class FullDisk(Fault):
    """The file system of the run is filled to its last byte, and freed after a while."""

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        self.impossible = place.arena.disk
        self._ballast = place.arena.small / "ballast"

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        with self._ballast.open("wb", buffering=0) as file:
            for size in (2**20, 2**12, 1):
                with contextlib.suppress(_NoSpaceError):
                    while True:
                        _write(file.fileno(), bytes(size))
        try:
            run.wait(numbers.uniform(0.1, 4.0))
        finally:
            self._ballast.unlink()


class KillRouter(Fault):
    """SIGKILL to a router at which all processes meet; another is started after a while."""

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        self._folder = tempfile.TemporaryDirectory(prefix="otc-")
        self.endpoint = f"unixsock-stream/{self._folder.name}/bus"
        self.flags = ("--set", f"bus.router={self.endpoint}")
        self._router: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self._start()
        return self

    def _start(self) -> None:
        command = [sys.executable, "-c", _ROUTER, self.endpoint]
        self._router = subprocess.Popen(command, preexec_fn=die_with_parent())

    def _stop(self) -> None:
        if self._router is not None:
            self._router.kill()
            self._router.wait()

    def __exit__(self, *failure: object) -> None:
        self._stop()
        self._folder.cleanup()

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        self._stop()
        run.wait(numbers.choice((0.0, numbers.uniform(0.0, 4.0))))
        self._start()


class Links(KillRouter):
    """All processes meet at a router by TCP, whose packets are lost for a while.

    Args:
        percent: of the packets that are lost; 100: the links are cut.
    """

    def __init__(self, place: Place, percent: int) -> None:
        super().__init__(place)
        self.impossible, self._percent = place.arena.net, percent
        self.endpoint = _TCP
        self.flags = ("--set", f"bus.router={_TCP}", "--insecure")

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        if self._percent == 100:
            self.arena.cut()
        else:
            self.arena.lose(self._percent)
        try:
            run.wait(numbers.uniform(0.2, 6.0))
        finally:
            self.arena.mend()


class Any(Fault):
    """One of those that every machine can have, at random."""

    KINDS = (KillHost, KillLearner, KillLauncher, Freeze, CorruptCheckpoint)

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        self._faults = [kind(place) for kind in self.KINDS]

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        numbers.choice(self._faults).strike(run, numbers)


FAULTS: dict[str, Callable[[Place], Fault]] = {
    "kill-host": KillHost,
    "kill-learner": KillLearner,
    "kill-launcher": KillLauncher,
    "kill-router": KillRouter,
    "freeze": Freeze,
    "cut-links": partial(Links, percent=100),
    "lose-1%": partial(Links, percent=1),
    "lose-5%": partial(Links, percent=5),
    "lose-20%": partial(Links, percent=20),
    "fill-disk": FullDisk,
    "corrupt-checkpoint": CorruptCheckpoint,
    "any": Any,
}


class _NoSpaceError(Exception):
    pass


def _write(file: int, data: bytes) -> None:
    try:
        os.write(file, data)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise _NoSpaceError from None


def _victim(
    run: DisturbedRun, numbers: Random, learners_only: bool = False
) -> tuple[str, ProcessState]:
    processes = {
        name: process
        for name, process in run.processes.items()
        if not (learners_only and name == HOST) and process.health == "up"
    }
    if not processes:
        raise MissedError
    name = numbers.choice(sorted(processes))
    return name, processes[name]


def _kill(run: DisturbedRun, name: str) -> None:
    process = run.processes.get(name)
    if process is None or process.health != "up":
        raise MissedError
    _send(process.pid, signal.SIGKILL)
    run.wait_for_restart(name, process.restarts)


def _send(pid: int, number: signal.Signals) -> None:
    try:
        os.kill(pid, number)
    except ProcessLookupError:  # it has ended by itself
        raise MissedError from None


def _newest_checkpoint(folder: RunFolder, name: str) -> Path | None:
    found = []
    for path in folder.agent(name).glob("*.safetensors"):
        with contextlib.suppress(FileNotFoundError):  # it has just been replaced by a later one
            found.append((path.stat().st_mtime_ns, path))
    return max(found)[1] if found else None


def _damage(path: Path, numbers: Random) -> None:
    """A flipped bit, a file that was cut off, or an empty one."""
    content = bytearray(path.read_bytes())
    way = numbers.randrange(3)
    if way == 0:
        content[numbers.randrange(len(content))] ^= 1 << numbers.randrange(8)
    else:
        del content[0 if way == 1 else numbers.randrange(len(content)) :]
    path.write_bytes(content)
