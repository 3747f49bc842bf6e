"""What the user sees while a run goes: a live table on a terminal, lines otherwise."""

import time
from typing import Protocol, Self

from rich.console import Console
from rich.live import Live
from rich.table import Table

from otc_dist.bus.keys import HOST
from otc_dist.bus.messages import Status
from otc_dist.progress import redraws

from . import forecast
from .board import Board, place
from .health import Life

LINE_EVERY = 5.0  # seconds between two progress lines without a terminal

# What samplers tell, its column and its format.
_TOLD = (("alpha", "alpha", ".3f"), ("similarity", "𝔻", ".3f"), ("accepted", "accepted", ".1%"))


class View(Protocol):
    """Shows a board. `say` prints a line that stays."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *failure: object) -> None: ...
    def say(self, line: str) -> None: ...
    def show(self, board: Board) -> None: ...


def open_view(title: str) -> View:
    """A live view on a terminal, plain lines otherwise."""
    return TableView(title) if redraws(Console()) else LineView()


class LineView:
    """One line at each event, and a progress line at most every LINE_EVERY seconds."""

    def __init__(self) -> None:
        self._last = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        pass

    def say(self, line: str) -> None:
        print(line, flush=True)

    def show(self, board: Board) -> None:
        for event in board.drain_events():
            self.say(event)
        now = time.monotonic()
        if board.busy and now - self._last >= LINE_EVERY:
            self._last = now
            self.say(_progress_line(board))


class TableView:
    """A table of all processes that redraws in place, events scrolling above it."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._console = Console(highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._start = time.monotonic()

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self._live.stop()

    def say(self, line: str) -> None:
        self._console.print(line, markup=False)

    def show(self, board: Board) -> None:
        for event in board.drain_events():
            self.say(event)
        self._live.update(self._table(board), refresh=True)

    def _table(self, board: Board) -> Table:
        left = "" if board.seconds_left is None else forecast.duration(board.seconds_left)
        ran = forecast.duration(time.monotonic() - self._start)
        table = Table(title=f"{self._title} · {ran} so far" + (f", {left} to go" if left else ""))
        table.add_column("process")
        table.add_column("health")
        table.add_column("phase")
        known = {name for measures in board.measures.values() for name in measures}
        told = [(name, label, style) for name, label, style in _TOLD if name in known]
        for name in ("done", "of", "rate /s", "return", *(label for _, label, _ in told)):
            table.add_column(name, justify="right")
        now = time.monotonic()
        for process in (HOST, *board.agents):
            status = board.newest.get(process, Status(process))
            measures = board.measures.get(process, {})
            table.add_row(
                process,
                health(board.lives.get(process), now),
                place(status),
                f"{status.update:,}" if status.total else "",
                f"{status.total:,}" if status.total else "",
                f"{status.rate:,.0f}" if status.total else "",
                *(
                    format(measures[name], style) if name in measures else ""
                    for name, style in (("return", ".1f"), *((n, s) for n, _, s in told))
                ),
            )
        return table


def health(life: Life | None, clock: float) -> str:
    """How a process is, and how often it has been started again: `silent for 2 s, restarts 1`."""
    if life is None:
        return ""
    lasting = life.state in ("silent", "waiting")
    told = f"{life.state} for {clock - life.since:.0f} s" if lasting else life.state
    return told + (f", restarts {life.restarts}" if life.restarts else "")


def _progress_line(board: Board) -> str:
    told = [
        f"{status.process} {place(status)}"
        + (f" {status.update:,}/{status.total:,}" if status.total else "")
        + (f" ({status.rate:,.0f}/s)" if status.rate else "")
        for status in board.busy
    ]
    left = "" if board.seconds_left is None else f" · {forecast.duration(board.seconds_left)} to go"
    return " · ".join(told) + left
