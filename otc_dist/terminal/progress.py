"""How far something that takes its time has come: a bar on a terminal, elsewhere lines."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from otc_dist.terminal.printable import printable, say

Report = Callable[[int, int], None]  # done, of how many

_DRAW_EVERY = 0.1  # seconds between two drawings of a bar
_LINE_EVERY = 10.0  # seconds between lines of progress where there is no terminal


def silent(done: int, total: int) -> None:
    """The `Report` that shows nothing."""


def redraws(console: Console) -> bool:
    """Whether what is shown there can be drawn over: a terminal, and none that is called dumb.

    Whatever FORCE_COLOR says, by which rich takes a file for a terminal.
    """
    return console.file.isatty() and not console.is_dumb_terminal


def beside(text: str) -> None:
    """Print a line on the standard error output, where another process may be drawing its bar.

    It takes the bar's place, and the bar is drawn again below.
    """
    over = "\r\x1b[2K" if redraws(Console(stderr=True)) else ""
    print(f"{over}{text}", file=sys.stderr, flush=True)


@contextmanager
def shown(doing: str, unit: str) -> Iterator[Report]:
    """Show on the standard error output how many of some `unit` are done, after what is `doing`."""
    console = Console(stderr=True)
    if redraws(console):
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f}"),
            TimeRemainingColumn(),
        )
        # Not drawn by a thread of its own: a process that stands still must be seen to do so.
        with Progress(*columns, console=console, transient=True, auto_refresh=False) as bar:
            task, drawn = None, -_DRAW_EVERY

            def draw(done: int, total: int) -> None:
                nonlocal task, drawn
                if task is None:
                    task = bar.add_task(printable(doing), total=total)
                due = time.monotonic() - drawn >= _DRAW_EVERY or done == total
                bar.update(task, completed=done, total=total, refresh=due)
                drawn = time.monotonic() if due else drawn

            yield draw
        return
    printed = time.monotonic()

    def write(done: int, total: int) -> None:
        nonlocal printed
        now = time.monotonic()
        if now - printed >= _LINE_EVERY or done == total:
            printed = now
            say(f"{doing}: {done:,} of {total:,} {unit}", file=sys.stderr)

    yield write
