"""What learners are busy with, for whoever waits for their answers."""

import time

from otc_dist.bus.messages import Status
from otc_dist.bus.status import BUSY
from otc_dist.terminal.progress import beside

_LINE_EVERY = 10.0  # seconds between two lines of a learner in the same phase


class BusyLearners:
    """Says of each learner when it begins with something that takes its time, and how far it is."""

    def __init__(self) -> None:
        self._said: dict[str, tuple[tuple[str, int], float]] = {}  # doing what, and when

    def __call__(self, status: Status) -> None:
        """Take a status, on any thread."""
        doing, now = (status.phase, status.deployment), time.monotonic()
        before, when = self._said.get(status.process, (None, now))
        busy = status.phase in BUSY
        if doing == before and (not busy or now - when < _LINE_EVERY):
            return
        self._said[status.process] = doing, now
        if busy:
            far = f", {status.update:,} of {status.total:,} updates" if status.total else ""
            beside(f"{status.process}: {status.phase}{far}")
