"""The few numbers that every table of returns shows."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

LEVEL = 0.95  # of intervals


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation (of the values themselves, ddof 0), range and count."""

    mean: float
    std: float
    minimum: float
    maximum: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread | None":
        """None without values."""
        if not values:
            return None
        array = np.asarray(values, np.float64)
        return cls(
            float(array.mean()),
            float(array.std()),
            float(array.min()),
            float(array.max()),
            len(values),
        )


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
    count = len(values)
    if count < 2:
        return math.nan, math.nan
    array = np.asarray(values, np.float64)
    quantile = float(stdtrit(count - 1, (1 + LEVEL) / 2))
    half = quantile * float(array.std(ddof=1)) / math.sqrt(count)
    return float(array.mean()) - half, float(array.mean()) + half
