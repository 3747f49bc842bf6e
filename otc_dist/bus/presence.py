"""Which learners are there, as the env host sees it by their liveliness tokens."""

import logging
import math
import threading
import time
from collections.abc import Callable, Sequence

from otc_dist.bus.keys import Keys
from otc_dist.bus.lockstep import GaveUpError
from otc_dist.bus.session import Session

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

    def wait_for_all(self, patience: float) -> None:
        """Return when every learner has come.

        Raises:
            GaveUpError: somebody has not come for `patience` seconds.
        """
        end, logged = time.monotonic() + patience, ""
        with self._changed:
            while missing := ", ".join(a for a in self._agents if a not in self._present):
                if missing != logged:
                    logged = missing
                    log.info("waiting for %s", missing)
                if not self._changed.wait(end - time.monotonic()):
                    raise GaveUpError(f"waited {patience:g} s for {missing} to come")

    def wait_for_none(self, timeout: float) -> None:
        """Return when every learner has left, or after `timeout` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: not self._present, timeout)
