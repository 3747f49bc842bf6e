"""How every process of a run is: what its token, its statuses and its ends say. No action here.

A process that can no longer run (frozen, or its machine is cut off) loses its liveliness token
with the lease of its link, 1.5 s. If it is also seen to use no processor time, it is frozen, and
is to be killed. A process whose heartbeat goes on while its work does not is stuck. The env host
says whose work is waited for: its own, or that of the agents that it names. Time in
which a process was kept from running by others does not count: a busy machine makes nobody stuck.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from otc_dist.bus.keys import HOST
from otc_dist.bus.messages import Status
from otc_dist.bus.status import BUSY
from otc_dist.description.distances import FITS

from .supervisor import End

LIMIT = 5  # restarts of a process in a row that neither bring it further nor last
LASTING = 60.0  # seconds
FIRST_DELAY = 0.25  # seconds from a death to the restart; doubles with every restart in a row
REPORT_AFTER = (
    2.0  # seconds without a token after which it is said: a busy machine loses it for less
)
FROZEN_AFTER = 3.0  # seconds without a token and without processor time
LEAVING = 30.0  # seconds that a process may take to end when all is done
_FRESH = 3.0  # seconds for which is believed whom the env host said it waits for

State = Literal["starting", "up", "silent", "waiting", "ended"]

# Order of the phases of one deployment, for learners and the env host alike.
_ORDER = {"starting": 0, "offline": 1, **dict.fromkeys(FITS, 2), "approval": 2, "reset": 3}
_LATER = {"deployment": 3, "tuning": 3, "evaluation": 4, "ready": 5, "done": 6}
_RANK = {**_ORDER, **_LATER}
Position = tuple[int, int, int]  # deployment, rank of the phase, update
# In these a process must get further by itself; the env host in them only while it waits for none.
_WORKING = BUSY | {"deployment", "evaluation", "done"}


@dataclass
class ProcessHealth:
    """One process.

    state: "starting" (no token yet), "up", "silent" (its token went), "waiting" (to be started
        again), "ended" (well).
    since: clock at which it came into this state, seconds.
    restarts: all of them; `futile_restarts`: those since it last got further than
        ever before, or lasted.
    """

    state: State = "starting"
    since: float = 0.0
    pid: int = 0
    started_at: float = 0.0  # clock at which this process was started
    restarts: int = 0
    futile_restarts: int = 0
    last_end: str = ""
    furthest: Position = (0, 0, 0)
    now: Status | None = None  # what it said last
    heard: float = 0.0  # clock at which it said it
    moved: float = 0.0  # clock at which it last said anything new of its work
    queued: float = 0.0  # seconds that it has waited for a processor, since it was started
    excluded: float = 0.0  # those since `moved`
    kill_reason: str = ""  # why it was to be killed
    idle_since: float = 0.0  # clock at which its processor time last changed, while silent
    processor: int = -1
    reported_silent: bool = False

    @property
    def working(self) -> bool:
        """Whether it must get further by itself now; not heard of yet, it must come."""
        return self.now is None or (self.now.phase in _WORKING and not self.now.awaits)

    def enter(self, state: State, clock: float) -> None:
        self.reported_silent = self.reported_silent and state == self.state
        self.state, self.since = state, clock
        self.idle_since, self.processor = clock, -1


class Health:
    """The health of the processes that one launcher has started.

    Args:
        names: of the processes.
        stuck_after: seconds that a process whose turn it is may take between two signs of progress.
        host_is_router: the env host's session carries the bus, so that a lost link means that
            the env host is silent; otherwise it says nothing about anybody.
    """

    def __init__(self, names: Iterable[str], stuck_after: float, host_is_router: bool) -> None:
        self.of_process = {name: ProcessHealth() for name in names}
        self._stuck_after, self._host_is_router = stuck_after, host_is_router
        self._linked, self._host_alive, self._over = False, False, False
        self._host: Status | None = None  # what the env host said last, wherever it runs
        self._host_heard = -_FRESH
        self._awaited: dict[str, float] = {}  # whom it waits for, and since when
        self._rejected: dict[str, float] = {}  # what it had rejected then, by reason
        self.events: list[str] = []

    def started(self, name: str, pid: int, clock: float) -> None:
        process = self.of_process[name]
        process.pid, process.started_at, process.moved, process.heard = pid, clock, clock, clock
        process.now, process.kill_reason, process.queued, process.excluded = None, "", 0.0, 0.0
        process.enter("starting", clock)

    def take_token(self, name: str, alive: bool, clock: float) -> None:
        """The token of a process appeared or went."""
        if name == HOST and alive and not self._host_alive:
            self.reset_deadlines(clock)  # the centre of the bus was away
        if name == HOST:
            self._host_alive = alive
        process = self.of_process.get(name)
        if process is None:
            return
        if alive and process.state in ("starting", "silent"):
            if process.reported_silent:
                self.events.append(f"{name}: is back")
            process.enter("up", clock)
        elif not alive and process.state == "up":
            process.enter("silent", clock)

    def take_link(self, linked: bool, clock: float) -> None:
        """The launcher's own link to the bus came or went."""
        self._linked = linked
        self.reset_deadlines(clock)

    def reset_deadlines(self, clock: float) -> None:
        """Count silence and standstill from now on: nothing could be heard until now."""
        for process in self.of_process.values():
            process.moved = process.heard = clock
            if process.state == "silent":
                process.enter("silent", clock)

    def take(self, status: Status, clock: float) -> None:
        """A process said what it does."""
        if status.process == HOST:
            self._over = status.phase == "done"
            self._take_host(status, clock)
        process = self.of_process.get(status.process)
        if process is None:
            return
        if process.now is None or _work(status) != _work(process.now):
            process.moved, process.excluded = clock, 0.0
        process.now, process.heard = status, clock
        position = (status.deployment, _RANK.get(status.phase, 0), status.update)
        if position > process.furthest:
            process.furthest, process.futile_restarts = position, 0

    def _take_host(self, status: Status, clock: float) -> None:
        """Note for whom the env host waits, and since when with this very question."""
        before = self._host
        if before is None or _work(status)[:-1] != _work(before)[:-1] or not status.awaits:
            self._awaited, self._rejected = {}, _rejected(before or status)
        self._awaited = {name: self._awaited.get(name, clock) for name in status.awaits}
        self._host, self._host_heard = status, clock

    def died(self, end: End, clock: float) -> float | None:
        """Seconds until it is to be started again; None if that has been tried often enough."""
        process = self.of_process[end.process]
        process.last_end = end.manner
        if process.kill_reason:
            process.last_end += f", since it {process.kill_reason}"
        if process.moved - process.started_at >= LASTING:  # not if it only waited for so long
            process.futile_restarts = 0
        if process.futile_restarts == LIMIT:
            return None
        delay: float = FIRST_DELAY * 2**process.futile_restarts
        process.futile_restarts += 1
        process.restarts += 1
        process.enter("waiting", clock)
        said = "" if process.kill_reason else "".join(f" ({line})" for line in end.last_lines(1))
        self.events.append(
            f"{end.process}: {process.last_end}{said}; starts again in {delay:g} s"
            f" ({process.futile_restarts} of {LIMIT})"
        )
        return delay

    def ended(self, name: str, clock: float) -> None:
        """It has ended well."""
        self.of_process[name].enter("ended", clock)

    def lost(
        self,
        clock: float,
        processor_time: Callable[[int], int | None],
        queued: Callable[[int], float] = lambda _: 0.0,
    ) -> dict[str, str]:
        """The processes to be killed: name -> why.

        Args:
            processor_time: what a process has used; None if that is not known: then its silence
                alone counts.
            queued: seconds that its main thread has waited for a processor; 0 if that is not known.
        """
        found = {}
        for name, process in self.of_process.items():
            self._exclude_waiting(name, process, clock, queued(process.pid))
            if self._worth_reporting(name, process, clock):
                process.reported_silent = True
                self.events.append(f"{name}: is silent")
            if process.state == "silent" and self._judged(name):
                used = processor_time(process.pid)
                if used is not None and used != process.processor:
                    process.idle_since, process.processor = clock, used
                elif clock - process.idle_since >= FROZEN_AFTER:
                    found[name] = "is frozen"
            elif process.state in ("starting", "up") and (why := self._stuck(name, process, clock)):
                found[name] = why
        for name in [name for name in found if self.of_process[name].kill_reason]:
            del found[name]  # it is being killed already
        for name, why in found.items():
            self.of_process[name].kill_reason = why
        return found

    def cut_off(self, why: str) -> dict[str, str]:
        """The env host, as in `lost`, where nobody can come to it any more while it serves.

        Existing links hold, but a process that starts again would find nobody.
        """
        process = self.of_process[HOST]
        done = process.now is not None and process.now.phase == "done"
        if process.state != "up" or done or process.kill_reason:
            return {}
        process.kill_reason = why
        return {HOST: why}

    def _worth_reporting(self, name: str, process: ProcessHealth, clock: float) -> bool:
        """Whether its silence lasts, is its own, and is not that of a run which is over: then all
        take their tokens with them a moment before their ends show.
        """
        lasts = process.state == "silent" and clock - process.since >= REPORT_AFTER
        over = self._over or (process.now is not None and process.now.phase == "done")
        return lasts and not process.reported_silent and not over and self._judged(name)

    def _stuck(self, name: str, process: ProcessHealth, clock: float) -> str:
        """What a process that can run has failed to do for too long; empty: nothing."""
        after, still = self._stuck_after, clock - process.moved - process.excluded
        if not self._linked:  # nothing can be heard; where the env host is to carry that, it is due
            due = name == HOST and self._host_is_router and process.state == "starting"
            return f"has not come for {after:g} s" if due and still >= after else ""
        if clock - process.heard - process.excluded >= after:
            return f"has said nothing for {after:g} s"
        if process.working:
            if process.now is not None and process.now.phase == "done":
                after = max(after, LEAVING)
            return f"has made no progress for {after:g} s" if still >= after else ""
        since = self._awaited.get(name)
        if since is None or clock - self._host_heard >= _FRESH:
            return ""
        if min(clock - since, still) < after:
            return ""
        return f"has given the env host no answer for {after:g} s{self._refusals()}"

    def _exclude_waiting(
        self, name: str, process: ProcessHealth, clock: float, queued: float
    ) -> None:
        """Do not count against a process the time in which others kept it from running."""
        more = max(0.0, queued - process.queued)
        process.queued = queued
        process.excluded += more
        if name in self._awaited:
            self._awaited[name] = min(clock, self._awaited[name] + more)

    def _refusals(self) -> str:
        """In brackets, what the env host has rejected since it waits for the same answer."""
        assert self._host is not None
        now = _rejected(self._host)
        grown = {name: n - self._rejected.get(name, 0.0) for name, n in now.items()}
        counts = ", ".join(f"{name} {n:.0f}" for name, n in grown.items() if n > 0)
        return f" that it could take ({counts} rejected)" if counts else ""

    def _judged(self, name: str) -> bool:
        """Whether a missing token speaks of the process, not of the way to it."""
        if self._host_is_router:
            return name == HOST or self._host_alive
        return self._linked


def _work(status: Status) -> tuple[object, ...]:
    """What changes while a process, or who it waits for, gets further."""
    return status.phase, status.deployment, status.update, status.awaits


def _rejected(status: Status) -> dict[str, float]:
    """How many messages a process says to have rejected, by reason."""
    prefix = "rejected/"
    return {
        name.removeprefix(prefix): n
        for name, n in status.metrics.items()
        if name.startswith(prefix)
    }
