"""What a run does before and after its processes, each by a command: data, compiling, report.

They have no place on the bus, so they are judged by what they use: one that is killed, or stands
still, is started again like a process of the run.
"""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from ..supervise.health import FIRST_DELAY, LIMIT
from ..supervise.processes import MISTAKE, DiedError
from ..supervise.signals import Signals
from ..supervise.standstill import Standstill
from ..supervise.supervisor import Supervisor

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
    """Run commands side by side, each to a good end, showing their progress.

    Args:
        commands: by name; none needs what another makes.
        output: where the command of that name prints.
        patience: seconds that a command may stand still.

    Raises:
        StoppedError: a signal came.
        DiedError: a command failed, or was killed too often; the supervisor still has the others.
    """
    due = dict.fromkeys(commands, 0.0)  # name -> when it starts, on the monotonic clock
    watched: dict[str, Standstill] = {}
    killed: dict[str, str] = {}  # name -> why
    restarts = Counter[str]()
    while due or watched:
        now = time.monotonic()
        for name in [name for name, start in due.items() if start <= now]:
            del due[name]
            supervisor.start(name, commands[name], output(name), show_errors=True)
            watched[name] = Standstill(supervisor.pid(name), patience)
        signals.wait(min(_LOOK, *(start - now for start in due.values())) if due else _LOOK)
        if signals.stop:
            raise StoppedError
        for end in supervisor.ended():
            name = end.process
            del watched[name]
            if end.status == 0:
                continue
            why = killed.pop(name, "")
            manner = end.manner + (f", since it {why}" if why else "")
            if end.status > 0 or restarts[name] == LIMIT:  # what it said was shown as it came
                raise DiedError(end, manner, restarts[name], explained=end.status == MISTAKE)
            delay = FIRST_DELAY * 2 ** restarts[name]
            restarts[name] += 1
            again = f"starts again in {delay:g} s ({restarts[name]} of {LIMIT})"
            print(f"{name}: {manner}; {again}", flush=True)
            due[name] = time.monotonic() + delay
        for name, standstill in watched.items():
            if name not in killed and (why := standstill.look(time.monotonic())):
                killed[name] = why
                supervisor.kill(name)
