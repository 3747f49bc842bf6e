"""Signals as something to wait for: an interrupt, or a child's end, wakes the main loop."""

import contextlib
import os
import select
import signal
from types import FrameType
from typing import Self

STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Signals:
    """While entered, SIGINT, SIGTERM and SIGHUP are noted in `stop` instead of raising anywhere.

    SIGHUP stays ignored where it is, as under nohup: that run goes on without its terminal.

    An exception out of a handler could fall between starting a child and noting that it runs,
    and the child would be orphaned; a note cannot.
    """

    def __init__(self) -> None:
        self.stop: signal.Signals | None = None  # the first of STOPPING that came
        self.repeated = False  # the user insists

    def __enter__(self) -> Self:
        self._read, self._write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._old_fd = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        self._old = {
            number: signal.signal(number, self._note)
            for number in STOPPING
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN
        }
        # A handler, even an empty one, makes a child's end wake `wait`.
        self._old[signal.SIGCHLD] = signal.signal(signal.SIGCHLD, lambda *_: None)
        return self

    def __exit__(self, *failure: object) -> None:
        for number, handler in self._old.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._old_fd)
        os.close(self._read)
        os.close(self._write)

    def _note(self, number: int, _: FrameType | None) -> None:
        self.repeated = self.stop is not None
        self.stop = self.stop or signal.Signals(number)

    def wake(self) -> None:
        """Let `wait` return, from any thread."""
        with contextlib.suppress(BlockingIOError):  # it is full: `wait` returns anyhow
            os.write(self._write, b"\0")

    def wait(self, seconds: float) -> None:
        """Sleep until a signal came (a child's end is one), `wake`, or `seconds` have passed."""
        ready, _, _ = select.select([self._read], [], [], seconds)
        if ready:
            os.read(self._read, 4096)
