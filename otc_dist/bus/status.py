"""Signs of life: each process says twice a second what it does; any listener keeps the newest."""

import math
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from otc_dist.bus.keys import Keys
from otc_dist.bus.messages import Status, decode_status, encode_status
from otc_dist.bus.session import Session
from otc_dist.bus.wire import RejectedError, Rejections
from otc_dist.description.distances import FITS

_PERIOD = 0.5  # seconds between two statuses of a process
_STARTS = 1000  # of one process that a board remembers

# What a learner may be busy with while the env host waits for it.
BUSY = frozenset({"starting", "offline", *FITS, "tuning"})


class Heartbeat:
    """Publishes what this process does, twice a second, from a thread of its own.

    So a process that compiles or trains still shows that it lives. Use it as a context manager:
    leaving it publishes once more and ends the thread.

    Args:
        describe: called on the heartbeat's thread; its `rate` and rejections are filled in here.
    """

    def __init__(
        self,
        session: Session,
        keys: Keys,
        process: str,
        rejections: Rejections,
        describe: Callable[[], Status],
    ) -> None:
        self._put = session.publisher(keys.status(process))
        self._run, self._rejections, self._describe = keys.run, rejections, describe
        self._before = (time.monotonic(), Status(process))
        self._start, self._beats = secrets.randbits(63), 0
        self.newest = Status(process)  # what was said last
        self._stop, self._lock = threading.Event(), threading.Lock()
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)

    def publish(self) -> None:
        """Say it now: at the beginning and the end of a phase."""
        with self._lock:
            status = self._describe()
            metrics = {**status.metrics, **self._rejections.as_metrics()}
            self._beats += 1
            newest = replace(status, rate=self._rate(status), metrics=metrics)
            self.newest = replace(newest, start=self._start, beat=self._beats)
            self._put(encode_status(self._run, self.newest))

    def _rate(self, status: Status) -> float:
        """Updates a second since the last measurement in the same phase."""
        now, (then, before) = time.monotonic(), self._before
        if (status.phase, status.deployment) != (before.phase, before.deployment):
            self._before = (now, status)
            return 0.0
        if now - then < _PERIOD / 2:
            return before.rate
        rate = max(0.0, (status.update - before.update) / (now - then))
        self._before = (now, replace(status, rate=rate))
        return rate

    def _beat(self) -> None:
        while not self._stop.wait(_PERIOD):
            self.publish()

    def __enter__(self) -> "Heartbeat":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.publish()


class StatusBoard:
    """The newest status of each watched process, and when it came.

    Args:
        on_status: called on Zenoh's thread with each accepted status; it must be quick.
    """

    def __init__(
        self,
        session: Session,
        keys: Keys,
        processes: tuple[str, ...],
        rejections: Rejections,
        on_status: Callable[[Status], None] | None = None,
    ) -> None:
        self._run, self._rejections, self._on_status = keys.run, rejections, on_status
        self._newest: dict[str, tuple[float, Status]] = {}
        self._busy: dict[str, float] = {}  # when it was last heard to be busy
        for process in processes:
            session.subscribe(keys.status(process), self._receiver(process))

    def _receiver(self, process: str) -> Callable[[bytes], None]:
        beats: dict[int, int] = {}  # start -> its last beat; in the order of their coming

        def receive(payload: bytes) -> None:
            try:
                status = decode_status(payload, self._run, process)
                if status.beat <= beats.get(status.start, -1):
                    raise RejectedError("stale")
            except RejectedError as rejected:
                self._rejections.count(rejected)
                return
            if status.start not in beats and len(beats) == _STARTS:
                del beats[next(iter(beats))]
            beats[status.start] = status.beat
            now = time.monotonic()
            self._newest[process] = (now, status)
            if status.phase in BUSY:
                self._busy[process] = now
            if self._on_status is not None:
                self._on_status(status)

        return receive

    def newest(self, process: str) -> Status | None:
        """None before the first."""
        entry = self._newest.get(process)
        return entry[1] if entry else None

    def heard_busy(self, process: str) -> float:
        """When (time.monotonic) it last said that it was busy; -inf before that."""
        return self._busy.get(process, -math.inf)

    def heard(self, process: str) -> float:
        """When (time.monotonic) the newest status came; -inf before the first."""
        entry = self._newest.get(process)
        return entry[0] if entry else -math.inf
