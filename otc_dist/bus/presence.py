"""Which learners are there, as the env host sees it by their liveliness tokens."""

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence

from otc_dist.bus.keys import Keys
from otc_dist.bus.lockstep import GaveUpError
from otc_dist.bus.session import Session

_LOOK = 0.5  # seconds between two words of how long it has waited

log = logging.getLogger(__name__)


class Presence:
    """Watches the tokens of all learners."""

    def __init__(self, session: Session, keys: Keys, agents: Sequence[str]) -> None:
        self._agents = agents
        self._present: set[str] = set()
        self._changed = threading.Condition()
        self._when: dict[str, float] = {}
        for agent in agents:
            session.watch_alive(keys.alive(agent), self._noting(agent))

    def _noting(self, agent: str) -> Callable[[bool], None]:
        def note(alive: bool) -> None:
            with self._changed:
                (self._present.add if alive else self._present.discard)(agent)
                self._when[agent] = time.monotonic()
                self._changed.notify_all()

        return note

    def changed(self, agent: str) -> float:
        """When (time.monotonic) it last came or went; -inf before that."""
        return self._when.get(agent, -math.inf)

    def wait_for_all(
        self, patience: float, waited: Callable[[float], None] = lambda seconds: None
    ) -> None:
        """Return when every learner has come.

        Args:
            waited: told now and then for how many seconds it has.

        Raises:
            GaveUpError: somebody has not come for `patience` seconds.
        """
        start, logged = time.monotonic(), ""
        with self._changed:
            while missing := ", ".join(a for a in self._agents if a not in self._present):
                if missing != logged:
                    logged = missing
                    log.info("waiting for %s", missing)
                waited(min(seconds := time.monotonic() - start, patience))
                if seconds >= patience:
                    raise GaveUpError(f"waited {patience:g} s for {missing} to come")
                self._changed.wait(min(_LOOK, patience - seconds))

    def wait_for_none(self, timeout: float) -> None:
        """Return when every learner has left, or after `timeout` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: not self._present, timeout)
