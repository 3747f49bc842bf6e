"""A tracker beside a run: whatever becomes of it, the run neither waits for it nor ends with it."""

import shlex
from typing import Self

from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import os_error_line
from otc_dist.terminal.printable import say

from ..plan.beside import Beside
from ..supervise.signals import Signals
from ..supervise.supervisor import End, Supervisor

_NAME = "tracking"


class Tracking:
    """The process that writes the run of `folder` to the tracker that is asked for, if one is.

    Entered, it starts. Left, it writes what is still missing and ends; one that hangs is killed
    after the seconds that every process has. One that has died is not started again: all that it
    would have written is in the run's folder, and the same command writes it at any time.
    """

    def __init__(self, beside: Beside, folder: RunFolder, signals: Signals) -> None:
        self._beside, self._folder = beside, folder
        self._supervisor = Supervisor(signals)  # of its own: the run goes by who runs in the other
        self._command = beside.tracking(folder.root)

    def __enter__(self) -> Self:
        if self._beside.tracker:
            try:
                self._supervisor.start(_NAME, self._command, self._folder.output(_NAME))
            except OSError as error:
                say(self._line(f"cannot start ({os_error_line(error)})"))
        return self

    def __exit__(self, *failure: object) -> None:
        for line in self._lines(self._supervisor.stop()):
            say(line)

    def events(self) -> list[str]:
        """What has happened since the last call, a line each."""
        return self._lines(self._supervisor.ended())

    def _lines(self, ends: list[End]) -> list[str]:
        return [self._line(_manner(end)) for end in ends if end.status != 0]

    def _line(self, what: str) -> str:
        again = shlex.join(word for word in self._command if word != "--follow")
        return f"{_NAME}: {what}; the run does not need it, and all is written by {again}"


def _manner(end: End) -> str:
    said = "".join(f" ({line.removeprefix('error: ')})" for line in end.last_lines(1))
    return f"{end.manner}{said}"
