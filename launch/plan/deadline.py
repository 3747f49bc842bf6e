"""A deadline for what happens in this very process: a user's code that is asked for its agents."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from otc_dist.terminal.errors import UserError


@contextmanager
def within(seconds: float, what: str) -> Iterator[None]:
    """End what is done inside when it takes too long; in the main thread only.

    Raises:
        UserError: `what` has taken longer.
    """

    def ring(*_: object) -> None:
        raise UserError(f"{what} has taken longer than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
