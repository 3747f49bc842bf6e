"""The processes of a run that this launcher keeps at work: started, watched, started again."""

import time
from pathlib import Path

from otc_dist.bus.keys import HOST
from otc_dist.system.kernel import processor_time, queued

from ..plan.plan import Plan
from .health import FROZEN_AFTER, Health
from .observer import Link, Sign, Token
from .supervisor import End, Supervisor

CLOSING = 5.0  # seconds: an env host that ends takes its socket with it before its end shows
MISTAKE = 2  # exit status of a process that met what only the user can fix
STOPPED = 3  # exit status of an env host that a person's file has stopped


class DiedError(Exception):
    """A process ended, and starting it again is of no use.

    Attributes:
        manner: how it ended, in words.
        explained: the user has seen the line in which the process itself said why.
    """

    def __init__(self, end: End, manner: str, restarts: int = 0, explained: bool = False) -> None:
        super().__init__(end.process)
        self.end, self.manner, self.restarts, self.explained = end, manner, restarts, explained


class StoppedByFileError(Exception):
    """A person's file has stopped the env host, in order. The message is its line."""


class RunProcesses:
    """Starts every process of `plan`, and again, after a while, those that die.

    Whatever dies goes on from what it had written, so a restart costs time and nothing else.
    """

    def __init__(self, plan: Plan, supervisor: Supervisor) -> None:
        self._plan, self._supervisor = plan, supervisor
        self._commands = {process.name: process.command for process in plan.processes}
        router = plan.placement.host_is_router
        self.health = Health(self._commands, plan.patience, host_is_router=router)
        self._due = dict.fromkeys(self._commands, 0.0)  # to be started -> when
        self._finished: set[str] = set()  # ended well
        self._socket: Path | None = None  # of the bus, where the env host listens
        self._missed: float | None = None  # when the socket was first not there
        self._looked = time.monotonic()

    @property
    def at_work(self) -> bool:
        """Whether something runs, or is to be started."""
        return bool(self._supervisor.running or self._due)

    def start_due(self) -> None:
        """Start what is due."""
        now = time.monotonic()
        for name in [name for name, when in self._due.items() if when <= now]:
            del self._due[name]
            if name == HOST:
                self._find_socket()
            self._supervisor.start(name, self._commands[name], self._plan.folder.output(name))
            self.health.started(name, self._supervisor.pid(name), now)

    def _find_socket(self) -> None:
        """Where the env host will listen; a process that looks elsewhere is started again."""
        before, self._socket = (
            self._socket,
            self._plan.placement.local_socket(self._plan.folder.root),
        )
        if before in (None, self._socket):
            return
        for name in self._supervisor.running:
            self._kill(name, f"waits where the bus was: it is at {self._socket} now")

    def _kill(self, name: str, why: str) -> None:
        self.health.events.append(f"{name}: {why}; killed")
        self._supervisor.kill(name)

    def take(self, sign: Sign) -> None:
        """Note a sign of life."""
        now = time.monotonic()
        if isinstance(sign, Token):
            self.health.take_token(sign.process, sign.alive, now)
        elif isinstance(sign, Link):
            self.health.take_link(sign.up, now)
        else:
            self.health.take(sign, now)

    def look(self) -> set[str]:
        """Kill what is lost, arrange for what died to start again; returns what has ended well.

        Raises:
            DiedError: a process met a mistake that the user must fix, or died too often.
            StoppedByFileError: the env host has ended since a person asked it to.
        """
        now = time.monotonic()
        if now - self._looked > FROZEN_AFTER:  # it was the launcher that was frozen
            self.health.reset_deadlines(now)
        self._looked = now
        for end in self._supervisor.ended():
            # A learner has nothing left to do once the host has ended well.
            if end.status == 0 or HOST in self._finished:
                self._finished.add(end.process)
                self.health.ended(end.process, now)
            elif end.process == HOST and end.status == STOPPED:
                raise StoppedByFileError("".join(end.last_lines(1)))
            else:
                self._start_again(end, now)
        lost = self.health.lost(now, processor_time, queued)
        lost |= self._cut_off(now)
        for name, why in lost.items():
            self._kill(name, why)
        return self._finished

    def _cut_off(self, now: float) -> dict[str, str]:
        """The env host, if nobody can come to it any more and it does not leave by itself."""
        if self._socket is None or self._socket.exists():
            self._missed = None
            return {}
        self._missed = self._missed or now
        if now - self._missed < CLOSING:
            return {}
        return self.health.cut_off(f"has lost the bus's socket, {self._socket}")

    def _start_again(self, end: End, now: float) -> None:
        delay = None if end.status == MISTAKE else self.health.died(end, now)
        if delay is None:
            process = self.health.of_process[end.process]
            raise DiedError(end, process.last_end or end.manner, process.futile_restarts)
        self._due[end.process] = now + delay
        if end.process == HOST:  # it will ask those that had left already once more
            self._due |= dict.fromkeys(self._finished, now + delay)
            self._finished.clear()

    def drain_events(self) -> list[str]:
        """What has happened since the last call."""
        events, self.health.events = self.health.events, []
        return events
