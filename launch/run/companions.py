"""Processes beside a run: whatever becomes of them, the run neither waits for them nor ends with
them.
"""

from typing import Self

from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import os_error_line
from otc_dist.terminal.printable import say

from ..plan.beside import Beside
from ..supervise.signals import Signals
from ..supervise.supervisor import End, Supervisor


class Companions:
    """The processes that are asked for beside the run of `folder`.

    Entered, they start. Left, each does what is still to do and ends; one that hangs is killed
    after the seconds that every process has. One that has died is not started again: what it reads
    is in the run's folder, and the same command reads it at any time.
    """

    def __init__(self, beside: Beside, folder: RunFolder, signals: Signals) -> None:
        self._folder = folder
        self._supervisor = Supervisor(signals)  # of its own: the run goes by who runs in the other
        self._companions = {each.name: each for each in beside.companions(folder.root)}

    def __enter__(self) -> Self:
        for name, companion in self._companions.items():
            try:
                self._supervisor.start(name, companion.command, self._folder.output(name))
            except OSError as error:
                say(self._line(name, f"cannot start ({os_error_line(error)})"))
        return self

    def __exit__(self, *failure: object) -> None:
        for line in self._lines(self._supervisor.stop()):
            say(line)

    def events(self) -> list[str]:
        """What has happened since the last call, a line each."""
        return self._lines(self._supervisor.ended())

    def _lines(self, ends: list[End]) -> list[str]:
        return [self._line(end.process, _manner(end)) for end in ends if end.status != 0]

    def _line(self, name: str, what: str) -> str:
        return f"{name}: {what}; the run does not need it, and {self._companions[name].again}"


def _manner(end: End) -> str:
    said = "".join(f" ({line.removeprefix('error: ')})" for line in end.last_lines(1))
    return f"{end.manner}{said}"
