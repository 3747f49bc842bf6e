"""What a run does before and after its processes, command by command: data, compiling, report.

They have no place on the bus, so they are judged by what they use: one that is killed, or stands
still, is started again like a process of the run.
"""

import itertools
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from ..supervise.health import FIRST_DELAY, LIMIT
from ..supervise.processes import MISTAKE, DiedError
from ..supervise.signals import Signals
from ..supervise.standstill import Standstill
from ..supervise.supervisor import End, Supervisor

_LOOK = 0.5  # seconds between two looks


class StoppedError(Exception):
    """The user, or the system, asked the launcher to stop."""


def run_one_off(
    commands: Mapping[str, tuple[str, ...]],
    output: Callable[[str], Path],
    supervisor: Supervisor,
    signals: Signals,
    patience: float,
) -> None:
    """Run commands one after the other, each to a good end, showing their progress.

    Args:
        output: where the command of that name prints.
        patience: seconds that a command may stand still.

    Raises:
        StoppedError: a signal came.
        DiedError: a command failed, or was killed too often.
    """
    for name, command in commands.items():
        for restarts in itertools.count():
            supervisor.start(name, command, output(name), show_errors=True)
            end, why = _end(name, supervisor, signals, patience)
            if end.status == 0:
                break
            manner = end.manner + (f", since it {why}" if why else "")
            if end.status > 0 or restarts == LIMIT:  # what it said was shown as it came
                raise DiedError(end, manner, restarts, told=end.status == MISTAKE)
            delay = FIRST_DELAY * 2**restarts
            again = f"starts again in {delay:g} s ({restarts + 1} of {LIMIT})"
            print(f"{name}: {manner}; {again}", flush=True)
            _pause(delay, signals)


def _end(name: str, supervisor: Supervisor, signals: Signals, patience: float) -> tuple[End, str]:
    """How a command ended, and why it was killed, if it was."""
    why, standstill = "", Standstill(supervisor.pid(name), patience)
    while True:
        if signals.stop:
            raise StoppedError
        signals.wait(_LOOK)
        for end in supervisor.ended():
            return end, why
        if not why and (why := standstill.look(time.monotonic())):
            supervisor.kill(name)


def _pause(seconds: float, signals: Signals) -> None:
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0 and not signals.stop:
        signals.wait(left)
