"""The faults: what each does to a run, once, at a time that others choose."""

import contextlib
import errno
import os
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random

from otc_dist.bus.keys import HOST
from otc_dist.run.folder import RunFolder

from ..show.process_states import ProcessState
from .disturbed_run import PHASES, WORKING, DisturbedRun
from .fault import Fault, MissedError, Setup
from .links import KillRouter, Links

_ALIVE = ("starting", "up")


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

    phases = tuple(phase for phase in PHASES if phase != "compile")

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        run.kill_launcher()


class KillPreparation(Fault):
    """SIGKILL to what makes the data, or the report, beside the processes of a run."""

    phases: tuple[str, ...] = ("data", "report")

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        preparing = run.preparing()
        if preparing is None:
            raise MissedError
        _send(preparing[1], signal.SIGKILL)


class KillCompiler(KillPreparation):
    """SIGKILL to what compiles the updates, or to the launcher meanwhile."""

    phases = ("compile",)
    changes = ("--set", "engine.name=compiled")

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        if numbers.random() < 0.5:
            super().strike(run, numbers)
        else:
            run.kill_launcher()


class Freeze(Fault):
    """SIGSTOP to a process: half of them go on after a while, the others are found and killed.

    One in five times it is the launcher, which always goes on.
    """

    phases = WORKING  # one that starts is only found when it should long have started

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

    phases = WORKING

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

    phases = (*Fault.phases, "report")
    small = True
    forgiving = True

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.impossible = setup.sandbox.disk
        self._ballast = setup.sandbox.small / "ballast"

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


class Any(Fault):
    """One of those that every machine can have, at random."""

    KINDS = (KillHost, KillLearner, KillLauncher, KillPreparation, Freeze, CorruptCheckpoint)
    phases = KillLauncher.phases

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._faults = [kind(setup) for kind in self.KINDS]

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        phase = run.phase
        fitting = [fault for fault in self._faults if phase in fault.phases]
        if not fitting:
            raise MissedError
        numbers.choice(fitting).strike(run, numbers)


FAULTS: dict[str, Callable[[Setup], Fault]] = {
    "kill-host": KillHost,
    "kill-learner": KillLearner,
    "kill-launcher": KillLauncher,
    "kill-preparation": KillPreparation,
    "kill-compiler": KillCompiler,
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
        if not (learners_only and name == HOST) and process.health in _ALIVE
    }
    if not processes:
        raise MissedError
    name = numbers.choice(sorted(processes))
    return name, processes[name]


def _kill(run: DisturbedRun, name: str) -> None:
    process = run.processes.get(name)
    if process is None or process.health not in _ALIVE:
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
