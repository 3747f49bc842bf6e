"""Faults of what lies between the processes of a run: a router, and the links to it."""

import subprocess
import sys
import tempfile
from random import Random
from typing import Self

from ..supervise.supervisor import die_with_parent
from .disturbed_run import DisturbedRun
from .fault import Fault, Setup

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


class KillRouter(Fault):
    """SIGKILL to a router at which all processes meet; another is started after a while."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
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

    def __init__(self, setup: Setup, percent: int) -> None:
        super().__init__(setup)
        self.impossible, self._percent = setup.sandbox.net, percent
        self.endpoint = _TCP
        self.flags = ("--set", f"bus.router={_TCP}", "--insecure")

    def strike(self, run: DisturbedRun, numbers: Random) -> None:
        if self._percent == 100:
            self.sandbox.cut()
        else:
            self.sandbox.drop_packets(self._percent)
        try:
            run.wait(numbers.uniform(0.2, 6.0))
        finally:
            self.sandbox.restore()
