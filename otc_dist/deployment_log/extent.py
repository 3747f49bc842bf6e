"""How much of its deployment a log holds, and how that is said."""

import tomllib
from dataclasses import dataclass
from typing import Literal

from otc_dist.deployment_log.header import LogHeader
from otc_dist.run.exploration import Schedule

Source = Literal["finished", "unfinished"]  # a log with its end, or without


@dataclass(frozen=True)
class Extent:
    """What there is of a deployment.

    Attributes:
        ranges: which steps, start..stop-1 of each pair; more than one where some are missing.
        scheduled: how many a whole deployment has, by its description (N M with sequential
            exploration); None: that is not known.
        finished: whether its writer finished it. Of a recovered one: whether what it was recovered
            from still had its end.
        recovered: whether it was made of what was whole of another file.
    """

    ranges: list[tuple[int, int]]
    scheduled: int | None
    finished: bool
    recovered: bool = False

    @property
    def steps(self) -> int:
        """How many there are."""
        return sum(high - low for low, high in self.ranges)

    @property
    def end(self) -> int:
        """The number after that of the last step."""
        return self.ranges[-1][1]

    @property
    def complete(self) -> bool:
        """Whether all steps are there, as far as its description gives their number."""
        return self.ranges == [(0, self.scheduled)]

    @property
    def whole(self) -> bool:
        """Whether all of the deployment is there for certain.

        Of how many steps a log was that was not finished, or that lost some, only its description
        can say; a writer that finishes has written all.
        """
        untold = self.scheduled is None and not self.recovered and not self.gaps
        return self.finished and (self.complete or untold)

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """Which steps are missing before the last, start..stop-1 of each pair."""
        found, before = [], 0
        for low, high in self.ranges:
            if low > before:
                found.append((before, low))
            before = high
        return found

    @property
    def missing(self) -> str:
        """Which steps are not there, in words."""
        found = self.gaps
        if self.scheduled is not None and self.end < self.scheduled:
            found.append((self.end, self.scheduled))
        words = _in_words(found)
        if self.scheduled is None and not self.whole:
            words += f" before step {self.end:,}, and how many follow is not known"
        return words

    @property
    def count(self) -> str:
        """How many steps of how many, in words."""
        if self.scheduled is None:
            return f"{self.steps:,} steps, of how many is not known"
        return f"{self.steps:,} of {self.scheduled:,} steps"

    @property
    def shortfall(self) -> str | None:
        """What keeps it from being the whole deployment, in words; None: nothing."""
        if self.whole:
            return None
        if not self.finished and not self.recovered:
            return f"unfinished: {self.count}"
        if self.complete:
            return f"recovered without its end: {self.count}"
        return f"partial: {self.count}"


def scheduled_steps(header: LogHeader) -> int | None:
    """How many lock-steps a deployment has by the description in its log; None: it gives none.

    What else another version wrote there need not be understood.
    """
    try:
        described = tomllib.loads(header.description)
        transitions, copies = described["deployment"]["transitions"], described["env"]["copies"]
        exploration = described["deployment"].get("exploration", "none")
    except (ValueError, RecursionError, KeyError, TypeError, AttributeError):
        return None
    if not (type(transitions) is type(copies) is int and transitions >= copies > 0):
        return None
    agents = len(header.team.agents)
    return Schedule(transitions // copies, agents, exploration == "sequential").steps


def _in_words(ranges: list[tuple[int, int]]) -> str:
    parts = [f"{low:,} to {high - 1:,}" for low, high in ranges]
    return f"steps {', '.join(parts)}" if parts else "none"
