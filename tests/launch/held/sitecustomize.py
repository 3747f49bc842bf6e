"""Python runs this first in a launcher that a test started with a hold, and in its processes.

`OTC_TEST_HOLD` is "PROCESS PHASE DEPLOYMENT GATE": that service says that it has entered the phase,
and waits at the gate, a FIFO, for as long as there is one. Its heart beats on, and signals end it.
The clocks of all are an hour slow while there is a file GATE.slow.
"""

import os
import sys
import threading
import time
from pathlib import Path


def _hold(process: str, phase: str, deployment: str, gate: Path) -> None:
    from otc_dist.bus.status import Heartbeat

    publish = Heartbeat.publish

    def publish_and_wait(self: Heartbeat) -> None:
        status = self._describe()
        publish(self)
        here = (status.process, status.phase, str(status.deployment)) == (
            process,
            phase,
            deployment,
        )
        if here and threading.current_thread() is threading.main_thread() and gate.exists():
            gate.open().close()  # returns when the test opens its end

    Heartbeat.publish = publish_and_wait  # type: ignore[method-assign]


def _clock(slow: Path) -> None:
    seconds, nanoseconds = time.time, time.time_ns

    def late() -> int:
        return 3600 if slow.exists() else 0

    time.time = lambda: seconds() - late()
    time.time_ns = lambda: nanoseconds() - late() * 10**9


if "OTC_TEST_HOLD" in os.environ:
    given = os.environ["OTC_TEST_HOLD"].split(" ", 3)
    _clock(Path(given[3] + ".slow"))
    if any("otc_dist.services" in word for word in sys.orig_argv):
        _hold(*given[:3], Path(given[3]))
