"""A paired difference over seeds, and its two intervals."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from otc_dist.randomness import stream
from otc_dist.report.return_statistics import LEVEL, interquartile_mean, student_interval
from otc_dist.transitions import Float64

RESAMPLES = 10_000


@dataclass(frozen=True)
class Difference:
    """One value minus another, seed by seed: the mean, and its intervals (NaN for one seed)."""

    seeds: list[int]
    values: list[float]  # one per seed
    mean: float
    iqm: float
    low: float  # bootstrap percentiles
    high: float
    t_low: float  # Student's t
    t_high: float

    @classmethod
    def of(cls, by_seed: Mapping[int, float]) -> "Difference":
        """Of at least one seed."""
        seeds = sorted(by_seed)
        values = np.array([by_seed[seed] for seed in seeds], np.float64)
        mean, iqm = float(values.mean()), float(interquartile_mean(values))
        return cls(
            seeds,
            values.tolist(),
            mean,
            iqm,
            *bootstrap(values),
            *student_interval(values.tolist()),
        )

    def __str__(self) -> str:
        """`+12.3 [-4.5, +29.1]`, with the bootstrap interval."""
        return f"{self.mean:+,.1f}{_in_brackets(self.low, self.high, ' ')}"

    @property
    def student(self) -> str:
        """`[-4.5, +29.1]`, Student's interval."""
        return _in_brackets(self.t_low, self.t_high) or "-"

    @property
    def above(self) -> int:
        """In how many seeds it is above 0."""
        return sum(value > 0 for value in self.values)

    @property
    def excludes_zero(self) -> bool:
        """Whether both intervals do; False for one seed."""
        return min(self.low, self.t_low) > 0 or max(self.high, self.t_high) < 0


def _in_brackets(low: float, high: float, before: str = "") -> str:
    return "" if math.isnan(low) else f"{before}[{low:+,.1f}, {high:+,.1f}]"


def bootstrap(values: Float64) -> tuple[float, float]:
    """95% percentile interval of the mean, from 10,000 resamples by a fixed stream.

    The same resamples of seeds for all arms of as many. With few values it is too narrow: at
    five, it holds the truth about 85 times in 100.
    """
    return stratified([values], np.mean)


def stratified(strata: Sequence[Float64], statistic: Callable[..., Float64]) -> tuple[float, float]:
    """95% percentile interval of a statistic of several samples, each resampled by itself, as
    `bootstrap`; NaN where one of them has a single value.

    Args:
        statistic: of all samples, with `axis`: that of the values, to be reduced.
    """
    from scipy import stats  # it takes a second

    counts = [len(values) for values in strata]
    if min(counts) < 2:
        return math.nan, math.nan
    found = stats.bootstrap(
        tuple(strata),
        statistic,
        n_resamples=RESAMPLES,
        confidence_level=LEVEL,
        method="percentile",
        rng=stream(0, "bootstrap", *counts),
    ).confidence_interval
    return float(found.low), float(found.high)
