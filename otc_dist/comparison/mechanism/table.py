"""What the mechanism check found, over seeds and agents: the rows, their means and errors."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from otc_dist.comparison.scores import read_json
from otc_dist.run.measured_returns import standard_error
from otc_dist.terminal.amounts import plus_minus
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import aligned

UNIFORM = "uniform, other minibatches"
ORACLE = "oracle: the mismatch itself"
ONLINE = "D_1 alone, uniform"
COLUMNS = {
    "mismatch": "mismatch",
    "offline": "mismatch in B_0",
    "error": "error of s'",
    "offline_error": "error in B_0",
    "value": "V(s')",
    "online": "share of D_1",
}


@dataclass(frozen=True)
class Estimate:
    """A mean over seeds and agents, and its standard error (NaN for a single value)."""

    mean: float
    error: float

    @classmethod
    def of(cls, values: Sequence[float | None]) -> "Estimate":
        """None counts as NaN."""
        array = np.asarray(values, np.float64)
        error = float(standard_error(array)) if len(array) > 1 else math.nan
        return cls(float(array.mean()), error)

    def __str__(self) -> str:
        return "-" if math.isnan(self.mean) else plus_minus(self.mean, self.error, digits=3)


@dataclass(frozen=True)
class Row:
    """One selector, over seeds and agents. Ratios are to uniform sampling."""

    name: str
    mismatch: Estimate  # of |a_-i - pi_-i(s)|, B_1
    offline: Estimate  # the same of B_0's transitions alone
    error: Estimate  # of the squared error of s'; NaN where no simulator gives it
    offline_error: Estimate  # the same of B_0's transitions alone
    value: Estimate  # of V(s'); NaN without a Q
    online: Estimate  # the share of D_1's own transitions

    @classmethod
    def of(cls, name: str, found: Sequence[Mapping[str, float | None]]) -> "Row":
        """From what every seed and agent gave."""
        return cls(name, *(Estimate.of([one[measure] for one in found]) for measure in COLUMNS))


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
        yield "error of s': squared, against the simulator's s' with the others acting as now;"
        yield "D_1's own transitions match themselves, so those of B_0 are also reported separately"
        known = {}  # of what is known
        for measure, title in COLUMNS.items():
            estimates: list[Estimate] = [getattr(row, measure) for row in self.rows]
            if not all(math.isnan(estimate.mean) for estimate in estimates):
                known[title] = [str(estimate) for estimate in estimates]
        columns = {"selected by": [row.name for row in self.rows], **known}
        yield from aligned([list(columns), *zip(*columns.values(), strict=True)], str.rjust)


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
