"""The clock of a deployment in real time, and the count of the deadlines that were missed.

A tick is the moment at which an observation is there. Answers to it are due one period later; the
next observation, too, and it is late once it comes half a period after that. Who steps faster than
the rate, like a simulator, is made to wait.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence

_LATE = 0.5  # periods
_FASTEST = 1.01  # of the rate: the clocks of devices differ by less
_WINDOW, _MOST = 20, 10  # steps that are looked at, and how many of them may miss a deadline


class Clock:
    """Args: now, wait: `time.monotonic` and `time.sleep`."""

    def __init__(
        self,
        rate_hz: float,
        now: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self._now, self._wait = now, wait
        self.period = 1 / rate_hz
        self._tick = self._budget = now()

    @property
    def due(self) -> float:
        """When the answers to the newest observation must be there (time.monotonic)."""
        return self._tick + self.period

    def begin(self) -> None:
        """An episode's first actions are about to be sent."""
        self._tick = self._now()
        self._budget = self._tick + self.period / _FASTEST

    def tick(self) -> bool:
        """The next observation is there; whether it was late. Returns no earlier than the rate
        allows: one period may be caught up, so that a jitter makes nobody wait.
        """
        here = self._now()
        late = here > self._tick + (1 + _LATE) * self.period
        if (early := self._budget - self.period - here) > 0:
            self._wait(early)
            here = self._now()
        self._tick = here
        self._budget = max(self._budget, here) + self.period / _FASTEST
        return late


class Misses:
    """Deadlines that the steps of one deployment have missed, since this process plays it."""

    def __init__(self, agents: Sequence[str]) -> None:
        self._agents = agents
        self._held = dict.fromkeys(agents, 0)
        self._late = self._steps = 0
        self._newest: deque[tuple[tuple[bool, ...], bool]] = deque(maxlen=_WINDOW)

    def note(self, held: tuple[bool, ...], late: bool) -> None:
        """Count one step: of each agent whether its action was held; whether what came was late."""
        self._steps += 1
        self._late += late
        for agent, missed in zip(self._agents, held, strict=True):
            self._held[agent] += missed
        self._newest.append((held, late))

    def begin(self) -> None:
        """Judge by the steps from here on."""
        self._newest.clear()

    @property
    def too_many(self) -> str | None:
        """Which ones, in words, where too many of the newest steps missed a deadline; or None."""
        missed = sum(any(held) or late for held, late in self._newest)
        if missed <= _MOST:
            return None
        by_agent = zip(*(held for held, _ in self._newest), strict=True)
        answers = [
            f"{agent} {sum(of_agent)}"
            for agent, of_agent in zip(self._agents, by_agent, strict=True)
            if any(of_agent)
        ]
        late = sum(late for _, late in self._newest)
        parts = [f"answers too late: {', '.join(answers)}"] if answers else []
        parts += [f"observations late: {late}"] if late else []
        return f"{missed} of {len(self._newest)} steps missed a deadline ({'; '.join(parts)})"

    @property
    def metrics(self) -> dict[str, float]:
        """For statuses."""
        return {"held": float(sum(self._held.values())), "late": float(self._late)}

    def __str__(self) -> str:
        held = ", ".join(f"{agent} {count:,}" for agent, count in self._held.items())
        return f"actions held: {held}; observations late: {self._late:,}; of {self._steps:,} steps"
