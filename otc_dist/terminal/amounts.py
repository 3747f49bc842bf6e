"""Amounts as people read them in a line of text."""

import math


def duration(seconds: float) -> str:
    """3725 -> '1 h 02 min', 65 -> '1 min 05 s', 5 -> '5 s'."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def plus_minus(mean: float, deviation: float, digits: int = 1) -> str:
    """`1,234.5 ± 67.8`; the mean alone where the deviation, or standard error, is NaN."""
    text = f"{mean:,.{digits}f}"
    return text if math.isnan(deviation) else f"{text} ± {deviation:,.{digits}f}"
