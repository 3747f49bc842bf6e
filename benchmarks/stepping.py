"""Taking turns: what the benchmarks of environments have in common."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np


@dataclass
class Row:
    """Something that plays; `turn` makes `steps` steps, those of E copies counted as E."""

    name: str
    steps: int
    turn: Callable[[], None]
    speeds: list[float] = field(default_factory=list)  # steps/s, round by round

    def measure(self) -> None:
        start = time.process_time()
        self.turn()
        self.speeds.append(self.steps / (time.process_time() - start))

    @property
    def median(self) -> float:
        return float(np.median(self.speeds))

    def times_as_fast_as(self, other: "Row") -> float:
        """The median over rounds of this speed by `other`'s."""
        return float(np.median(np.divide(self.speeds, other.speeds)))


def alternate(rows: Sequence[Row], rounds: int) -> None:
    """`rounds` turns of every row, after one to warm up."""
    for row in rows:
        row.turn()
    for _ in range(rounds):
        for row in rows:
            row.measure()
