"""What the mechanism check found, over seeds and agents: the rows, their means and errors."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from otc_dist.comparison.scores import read_json
from otc_dist.comparison.tables import aligned
from otc_dist.errors import UserError

BALANCED = "Balanced Replay"
UNIFORM = "uniform, other minibatches"
ORACLE = "oracle: the mismatch itself"
ONLINE = "D_1 alone, uniform"


@dataclass(frozen=True)
class Estimate:
    """A mean over seeds and agents, and its standard error (NaN for a single value)."""

    mean: float
    error: float

    @classmethod
    def of(cls, values: Sequence[float | None]) -> "Estimate":
        """None counts as NaN."""
        array = np.asarray(values, np.float64)
        many = len(array) > 1
        error = float(array.std(ddof=1)) / math.sqrt(len(array)) if many else math.nan
        return cls(float(array.mean()), error)

    def __str__(self) -> str:
        if math.isnan(self.mean):
            return "-"
        return f"{self.mean:.3f}" + ("" if math.isnan(self.error) else f" ± {self.error:.3f}")


@dataclass(frozen=True)
class Row:
    """One way of selecting, over seeds and agents. Ratios are to uniform sampling."""

    name: str
    mismatch: Estimate  # of |a_-i - pi_-i(s)|, B_1
    offline: Estimate  # the same of B_0's transitions alone
    value: Estimate  # of V(s')
    online: Estimate  # the share of D_1's own transitions

    @classmethod
    def of(cls, name: str, found: Sequence[Mapping[str, float | None]]) -> "Row":
        """From what every seed and agent gave."""
        measures = ("mismatch", "offline", "value", "online")
        return cls(name, *(Estimate.of([one[measure] for one in found]) for measure in measures))

    def cells(self) -> list[str]:
        """For a table."""
        return [self.name, *map(str, (self.mismatch, self.offline, self.value, self.online))]


@dataclass(frozen=True)
class Mechanism:
    """The whole check."""

    seeds: int
    agents: int
    pool: int
    minibatches: int
    rows: list[Row]
    uniform_mismatch: Estimate  # |a_-i - pi_-i(s)| under uniform sampling, in units of actions

    def lines(self) -> Iterator[str]:
        """For people."""
        seeds = "1 seed" if self.seeds == 1 else f"{self.seeds} seeds"
        yield (
            f"mean ± standard error over {seeds} x {self.agents} agents;"
            f" {self.minibatches} minibatches each, from a random {self.pool:,} rows of B_1"
        )
        yield f"|a_-i - pi_-i(s)| under uniform sampling: {self.uniform_mismatch}"
        yield "ratios to uniform sampling (mismatch below 1: nearer to the online dynamics);"
        yield "D_1's own transitions match themselves, so those of B_0 are also told apart"
        head = ["selected by", "mismatch", "mismatch in B_0", "V(s')", "share of D_1"]
        lines = [head, *(row.cells() for row in self.rows)]
        if all(math.isnan(row.value.mean) for row in self.rows):  # the algorithm has no Q
            lines = [[*line[:3], *line[4:]] for line in lines]
        yield from aligned(lines)


def read(paths: Sequence[Path]) -> Mechanism:
    """Combine the files of some seeds, with the rows that the algorithm has.

    Raises:
        UserError: a file is damaged.
    """
    files = [read_json(path) for path in paths]
    try:
        uniform = [value for file in files for value in file["uniform_mismatch"].values()]
        rows = [
            Row.of(name, [one for file in files for one in file["selected"][name].values()])
            for name in files[0]["selected"]
        ]
        first = files[0]
        agents = len(first["uniform_mismatch"])
        pool, minibatches = first["pool"], first["minibatches"]
        return Mechanism(len(files), agents, pool, minibatches, rows, Estimate.of(uniform))
    except (KeyError, TypeError, AttributeError) as error:
        raise UserError(f"a file in {paths[0].parent} is damaged ({error}); delete it") from None
