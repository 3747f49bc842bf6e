"""What the mechanism check found, over seeds and agents: the rows, their means and errors."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from otc_dist.comparison.scores import read_json
from otc_dist.comparison.tables import aligned
from otc_dist.errors import UserError

UNIFORM = "uniform, other minibatches"
ORACLE = "oracle: the mismatch itself"
ONLINE = "D_1 alone, uniform"
ROWS = (
    "d_e",
    "d_q, paper",
    "d_q, shared",
    "d_q, relative",
    "raw (s, a) match, raw s'",
    "nearness in (s, a) alone",
    UNIFORM,
    ORACLE,
    ONLINE,
)


@dataclass(frozen=True)
class Estimate:
    """A mean over seeds and agents, and its standard error (NaN for a single value)."""

    mean: float
    error: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Estimate":
        array = np.asarray(values, np.float64)
        many = len(array) > 1
        error = float(array.std(ddof=1)) / math.sqrt(len(array)) if many else math.nan
        return cls(float(array.mean()), error)

    def __str__(self) -> str:
        return f"{self.mean:.3f}" + ("" if math.isnan(self.error) else f" ± {self.error:.3f}")


@dataclass(frozen=True)
class Row:
    """One way of selecting: its ratios to uniform sampling from B_1."""

    name: str
    mismatch: Estimate  # of |a_-i - pi_-i(s)|
    value: Estimate  # of V(s')


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
        yield (
            f"mean ± standard error over {self.seeds} seeds x {self.agents} agents;"
            f" {self.minibatches} minibatches each, from a random {self.pool:,} rows of B_1"
        )
        yield f"|a_-i - pi_-i(s)| under uniform sampling: {self.uniform_mismatch}"
        yield "ratios to uniform sampling (mismatch below 1: nearer to the online dynamics)"
        yield from aligned(
            [
                ["selected by", "mismatch", "V(s')"],
                *([row.name, str(row.mismatch), str(row.value)] for row in self.rows),
            ]
        )


def read(paths: Sequence[Path]) -> Mechanism:
    """Combine the files of some seeds. Raises UserError if one is damaged."""
    files = [read_json(path) for path in paths]
    try:
        agents = list(files[0]["uniform"])
        uniform = [file["uniform"][agent]["mismatch"] for file in files for agent in agents]
        rows = [_row(name, files, agents) for name in ROWS]
        first = files[0]
        return Mechanism(
            len(files),
            len(agents),
            first["pool"],
            first["minibatches"],
            rows,
            Estimate.of(uniform),
        )
    except (KeyError, TypeError) as error:
        raise UserError(f"a file in {paths[0].parent} is damaged ({error}); delete it") from None


def _row(name: str, files: Sequence[Mapping[str, Any]], agents: Sequence[str]) -> Row:
    found = [file["ratios"][name][agent] for file in files for agent in agents]
    return Row(
        name,
        Estimate.of([ratios["mismatch"] for ratios in found]),
        Estimate.of([ratios["value"] for ratios in found]),
    )
