"""What the user sees while a run goes: a live table on a terminal, lines otherwise."""

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, Self

from rich.console import Console
from rich.live import Live
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from otc_dist.bus.keys import HOST
from otc_dist.bus.messages import Status
from otc_dist.terminal.amounts import duration
from otc_dist.terminal.printable import printable, say
from otc_dist.terminal.progress import redraws

from ..supervise.health import ProcessHealth
from .board import Board, describe_phase

LINE_EVERY = 5.0  # seconds between two progress lines without a terminal

# What samplers report, its column and its format.
_TOLD = (("alpha", "alpha", ".3f"), ("similarity", "𝔻", ".3f"), ("accepted", "accepted", ".1%"))
_WIDEST = 1000  # characters that a table may want
_WORDS = ("process", "health", "phase")  # headings of columns of words; all others are numbers
_SPARE = ("rate /s", *(heading for _, heading, _ in reversed(_TOLD)), "return", "done", "health")


class View(Protocol):
    """Shows a board. `say` prints a line that stays."""

    def __enter__(self) -> Self: ...
    def __exit__(self, *failure: object) -> None: ...
    def say(self, line: str) -> None: ...
    def show(self, board: Board) -> None: ...


def open_view(title: str) -> View:
    """A live view on a terminal, plain lines otherwise; neither ends what it shows by failing."""
    return CarefulView(TableView(title) if redraws(Console()) else LineView())


class CarefulView:
    """Shows by another view; where that fails, it says so and shows lines, and at last nothing."""

    def __init__(self, view: View) -> None:
        self._view: View | None = view

    def __enter__(self) -> Self:
        self._do(lambda view: view.__enter__())
        return self

    def __exit__(self, *failure: object) -> None:
        self._do(lambda view: view.__exit__(*failure))

    def say(self, line: str) -> None:
        self._do(lambda view: view.say(line))

    def show(self, board: Board) -> None:
        self._do(lambda view: view.show(board))

    def _do(self, what: Callable[[View], object]) -> None:
        failed = self._view
        if failed is None:
            return
        try:
            what(failed)
        except Exception as error:  # whatever a library that draws may raise
            with suppress(Exception):
                failed.__exit__()
            self._view = None if isinstance(failed, LineView) else LineView()
            self.say(f"the table cannot be drawn ({type(error).__name__}: {error}): lines follow")


class LineView:
    """One line at each event, and at most every LINE_EVERY seconds one of new progress."""

    def __init__(self) -> None:
        self._last, self._said = 0.0, ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        pass

    def say(self, line: str) -> None:
        say(line)

    def show(self, board: Board) -> None:
        for event in board.drain_events():
            self.say(event)
        now = time.monotonic()
        if board.busy and now - self._last >= LINE_EVERY:
            self._last, before = now, self._said
            self._said = ", ".join(map(_progress, board.busy))
            if self._said != before:  # nothing is said twice
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
        self._console.print(printable(line), markup=False)

    def show(self, board: Board) -> None:
        for event in board.drain_events():
            self.say(event)
        self._live.update(self._table(board), refresh=True)

    def _table(self, board: Board) -> Table:
        """With as many columns as the terminal has room for: the least informative are left out."""
        left = "" if board.seconds_left is None else duration(board.seconds_left)
        ran = duration(time.monotonic() - self._start)
        title = f"{self._title} · {ran} so far" + (f", {left} to go" if left else "")
        columns = _columns(board)
        for name in ("", *_SPARE):
            columns.pop(name, None)
            table = Table(title=Text(printable(title)))
            for heading in columns:
                table.add_column(heading, justify="left" if heading in _WORDS else "right")
            for row in zip(*columns.values(), strict=True):
                table.add_row(*(Text(printable(cell)) for cell in row))
            anywhere = self._console.options.update(max_width=_WIDEST)
            if Measurement.get(self._console, anywhere, table).maximum <= self._console.width:
                break
        return table


def _columns(board: Board) -> dict[str, list[str]]:
    """All that is known, by heading: a cell for the host, and one for each agent."""
    processes, now = (HOST, *board.agents), time.monotonic()
    statuses = [board.newest.get(process, Status(process)) for process in processes]
    known = {name for measures in board.measures.values() for name in measures}
    columns = {
        "process": list(processes),
        "health": [health(board.of_process.get(process), now) for process in processes],
        "phase": [describe_phase(status) for status in statuses],
        "done": [f"{s.update:,}/{s.total:,}" if s.total else "" for s in statuses],
        "rate /s": [f"{s.rate:,.0f}" if s.total else "" for s in statuses],
    }
    for name, heading, style in (("return", "return", ".1f"), *_TOLD):
        if name in known:
            found = [board.measures.get(process, {}) for process in processes]
            columns[heading] = [format(m[name], style) if name in m else "" for m in found]
    return columns


def health(process: ProcessHealth | None, clock: float) -> str:
    """How a process is, and how often it has been started again: `silent for 2 s, restarts 1`."""
    if process is None:
        return ""
    lasting = process.state in ("silent", "waiting")
    text = f"{process.state} for {clock - process.since:.0f} s" if lasting else process.state
    return text + (f", restarts {process.restarts}" if process.restarts else "")


def _progress(status: Status) -> str:
    done = f" {status.update:,}/{status.total:,}" if status.total else ""
    return f"{status.process} {describe_phase(status)}{done}"


def _progress_line(board: Board) -> str:
    text = [
        _progress(status) + (f" ({status.rate:,.0f}/s)" if status.rate else "")
        for status in board.busy
    ]
    left = "" if board.seconds_left is None else f" · {duration(board.seconds_left)} to go"
    return " · ".join(text) + left
