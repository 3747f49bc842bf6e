"""Axes of charts: from values to px, with ticks."""

import math
from dataclasses import dataclass
from typing import Self

from otc_dist.report.numbers import MINUS

Range = tuple[float, float]  # the least and the greatest value that must have a place


@dataclass(frozen=True)
class Axis:
    """From values to px, with ticks (value, text)."""

    low: float
    high: float
    start: float
    stop: float
    ticks: list[tuple[float, str]]
    log: bool = False

    def at(self, value: float) -> float:
        """Where a value is, px."""
        if self.log:
            value = math.log10(value)
        share = (value - self.low) / (self.high - self.low)
        return self.start + share * (self.stop - self.start)

    @classmethod
    def linear(
        cls,
        low: float,
        high: float,
        start: float,
        stop: float,
        *,
        whole: bool = False,
        fit: bool = False,
    ) -> Self:
        """`whole`: no ticks between integers; `fit`: end at the data, not at a tick."""
        least, most = low, high
        if high <= low:
            reach = abs(low) * 0.1 or 1.0
            low, high = low - reach, high + reach
        room = max(2.0, abs(stop - start) / 60)
        step = _nice((high - low) / room)
        if whole:
            step = max(step, 1.0)
        first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        values = [i * step for i in range(first, last + 1)]
        if fit:
            values = [v for v in values if least - 1e-9 * step <= v <= most + 1e-9 * step]
        else:
            low, high = first * step, last * step
        texts = [f"{value:,.{decimals}f}".replace("-", MINUS) for value in values]
        return cls(low, high, start, stop, list(zip(values, texts, strict=True)))

    @classmethod
    def logarithmic(cls, low: float, high: float, start: float, stop: float) -> Self:
        """Of values > 0."""
        bottom, top = math.log10(low) - 0.02, math.log10(high) + 0.02
        decades = range(math.floor(bottom), math.ceil(top) + 1)
        within = (1, 2, 5) if top - bottom < 2.5 else (1,)
        values = [m * 10.0**d for d in decades for m in within]
        values = [v for v in values if bottom <= math.log10(v) <= top]
        return cls(bottom, top, start, stop, [(v, f"{v:,.10g}") for v in values], log=True)


def _nice(step: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below `step`."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= step * (1 - 1e-9))
