"""Numbers as people read them."""

import math
from collections.abc import Iterable

NOTHING = "\N{EN DASH}"  # stands where there is no value
MINUS = "\N{MINUS SIGN}"


def number(value: float) -> str:
    """One by itself: four significant digits or a whole number, thousands separated."""
    if not math.isfinite(value):
        return NOTHING
    if value == round(value) and abs(value) < 1e9:
        return _grouped(value, 0)
    digits = _decimals(value)
    return f"{value:.2e}" if digits > 6 else _grouped(value, min(digits, 4))


def column(values: Iterable[float | None]) -> list[str]:
    """A column of a table, with as many decimals everywhere as the largest of them needs."""
    return columns(values)[0]


def columns(*groups: Iterable[float | None]) -> list[list[str]]:
    """Columns of one unit: with as many decimals everywhere as the largest number in them needs."""
    cells = [list(group) for group in groups]
    found = [x for group in cells for x in group if x is not None and math.isfinite(x)]
    whole = all(value == round(value) for value in found)
    largest = max(map(abs, found), default=0.0)
    digits = 0 if whole or not largest else min(_decimals(largest), 6)

    def text(value: float | None) -> str:
        absent = value is None or not math.isfinite(value)
        return NOTHING if value is None or absent else _grouped(value, digits)

    return [list(map(text, group)) for group in cells]


def signed(value: float | None, unit: str = "") -> str:
    """With its sign: `+1,234.5`."""
    if value is None or not math.isfinite(value):
        return NOTHING
    return f"{value:+,.1f}{unit}".replace("-", MINUS)


def percent(value: float | None) -> str:
    """`12.5 %`."""
    return NOTHING if value is None else f"{value:.1f} %"


def _decimals(value: float) -> int:
    """As many as make four significant digits."""
    return max(0, 3 - math.floor(math.log10(abs(value))))


def _grouped(value: float, digits: int) -> str:
    return f"{value:,.{digits}f}".replace("-", MINUS)
