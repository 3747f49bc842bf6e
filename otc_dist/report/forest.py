"""Differences with their intervals, one below the other, beside the line of no difference."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from otc_dist.report.axes import Axis, Range
from otc_dist.report.numbers import NOTHING, signed
from otc_dist.report.svg import LETTER, colour_class
from otc_dist.terminal.printable import on_page

_ROW, _TOP, _BOTTOM, _EDGE = 30.0, 34.0, 40.0, 8.0  # px
_NUMBER = 66.0  # px, of the mean to the right
_MOST_LABEL = 0.34  # of the width; a longer label stands above its row's interval


@dataclass(frozen=True)
class Row:
    """One difference. Both intervals are NaN where there is none, as for one seed."""

    label: str
    colour: int
    value: float
    narrow: tuple[float, float]  # drawn as a thick bar
    wide: tuple[float, float]  # drawn as a thin one


def reach(rows: Sequence[Row]) -> Range:
    """What an axis of these must hold; 0 is in it."""
    values = [x for row in rows for x in (row.value, *row.narrow, *row.wide) if math.isfinite(x)]
    return min([*values, 0.0]), max([*values, 0.0])


def forest(rows: Sequence[Row], *, title: str, x_label: str, x_range: Range, width: float) -> str:
    """An `<svg>` with a row each, in their order."""
    longest = LETTER * max((len(row.label) for row in rows), default=0)
    above = longest > _MOST_LABEL * width
    left = _EDGE if above else _EDGE + longest + 12
    pitch = _ROW + (14 if above else 0)
    bottom = _TOP + pitch * len(rows)
    axis = Axis.linear(*x_range, left + 10, width - _NUMBER - 10)
    parts = [
        f'<svg class="chart" viewBox="0 0 {width:g} {bottom + _BOTTOM:g}" role="img"'
        f' aria-label="{on_page(title)}"><title>{on_page(title)}</title>'
        f'<text class="title" x="{_EDGE:g}" y="14">{on_page(title)}</text>'
    ]
    for value, text in axis.ticks:
        x, kind = axis.at(value), "zero" if value == 0 else "grid"
        parts.append(
            f'<line class="{kind}" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP - 8:g}" y2="{bottom:g}"/>'
            f'<text x="{x:.1f}" y="{bottom + 15:g}" text-anchor="middle">{text}</text>'
        )
    middle = (left + width - _NUMBER) / 2
    parts.append(
        f'<text x="{middle:.1f}" y="{bottom + 33:g}" text-anchor="middle">{on_page(x_label)}</text>'
    )
    for i, row in enumerate(rows):
        y = _TOP + pitch * i + (_ROW / 2 if not above else 14 + _ROW / 2 - 4)
        label = (
            f'<text class="name" x="{_EDGE:g}" y="{_TOP + pitch * i + 8:g}">'
            if above
            else f'<text class="name" x="{_EDGE:g}" y="{y + 4:.1f}">'
        )
        parts.append(f"{label}{on_page(row.label)}</text>{_drawn(row, axis, y, width)}")
    return "".join(parts) + "</svg>"


def _drawn(row: Row, axis: Axis, y: float, width: float) -> str:
    text = signed(row.value)
    if not math.isfinite(row.value):
        return f'<text x="{width - _EDGE:g}" y="{y + 4:.1f}" text-anchor="end">{NOTHING}</text>'
    parts, intervals = [], [text]
    for (low, high), kind, cap in ((row.wide, "bar", 4.0), (row.narrow, "wide-bar", 0.0)):
        if math.isfinite(low) and math.isfinite(high):
            start, stop = axis.at(low), axis.at(high)
            ends = f"m0 -{cap:g}v{2 * cap:g}m0 -{cap:g}" if cap else ""
            parts.append(f'<path class="{kind}" d="M{start:.1f} {y:.1f}{ends}H{stop:.1f}{ends}"/>')
            intervals.append(f"[{signed(low)}, {signed(high)}]")
    tip = f"{row.label}: {' '.join(intervals)}"
    parts.append(
        f'<circle class="mark" cx="{axis.at(row.value):.1f}" cy="{y:.1f}" r="4.6">'
        f"<title>{on_page(tip)}</title></circle>"
        f'<text x="{width - _EDGE:g}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
    )
    return f'<g class="{colour_class(row.colour)}">{"".join(parts)}</g>'
