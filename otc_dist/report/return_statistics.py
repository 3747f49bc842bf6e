"""The few numbers that every table of returns shows."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from otc_dist.terminal.amounts import plus_minus
from otc_dist.transitions import Float64

LEVEL = 0.95  # of intervals


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation (ddof 1; NaN for one value), interquartile mean, range and count:
    of the returns of episodes, or of one value a seed.
    """

    mean: float
    std: float
    iqm: float
    minimum: float
    maximum: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float] | Float64) -> "Spread":
        """All NaN if one of the values is not finite, or there is none."""
        array, count = np.asarray(values, np.float64), len(values)
        if not count or not np.isfinite(array).all():
            return cls(*(math.nan,) * 5, count)
        std = float(array.std(ddof=1)) if count > 1 else math.nan
        iqm = float(interquartile_mean(array))
        return cls(float(array.mean()), std, iqm, float(array.min()), float(array.max()), count)

    def __str__(self) -> str:
        """`1,234.5 ± 67.8`."""
        return plus_minus(self.mean, self.std)

    @property
    def band(self) -> tuple[float, float]:
        """One standard deviation to each side of the mean; nothing around a single value."""
        std = 0.0 if self.count == 1 else self.std
        return self.mean - std, self.mean + std


def interquartile_mean(values: Float64, axis: int = -1) -> Float64:
    """The mean without the lowest and the highest quarter (rounded down) of at least one value."""
    count = values.shape[axis]
    middle = range(count // 4, count - count // 4)
    found: Float64 = np.take(np.sort(values, axis), middle, axis).mean(axis)
    return found


def improvement(value: float, before: float) -> float | None:
    """100 (R_k - R_0) / |R_0|, in percent; None where R_0 is 0. It explodes near R_0 = 0: show
    the difference in normalised score beside it.
    """
    if before == 0 or not math.isfinite(value) or not math.isfinite(before):
        return None
    return 100.0 * (value - before) / abs(before)


def student_interval(values: Sequence[float]) -> tuple[float, float]:
    """95% interval of the mean by Student's t, which few values make as wide as they must; NaN for
    one.
    """
    from scipy import stats  # it takes a second

    if len(values) < 2:
        return math.nan, math.nan
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of equal values
        found = stats.ttest_1samp(values, 0.0).confidence_interval(LEVEL)
    return float(found.low), float(found.high)
