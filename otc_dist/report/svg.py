"""Line charts as SVG text: no script, nothing external, colours from the page's style sheet.

`STYLE` belongs into the page once; the charts then follow its light or dark scheme.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from otc_dist.report.axes import Axis, Range
from otc_dist.report.numbers import number
from otc_dist.terminal.printable import on_page

# Of light and of dark pages, in order; the first six are those of agents wherever they are shown.
_PALETTE = (
    ("#2563c9", "#74a7ff"),
    ("#c8501e", "#ff9466"),
    ("#17826a", "#4fd0ae"),
    ("#9a3fa0", "#dd92e3"),
    ("#9a7200", "#e3bd4a"),
    ("#188ab2", "#5cc6e8"),
    ("#b8336a", "#ff8fb8"),
    ("#5f7d1e", "#b0d462"),
    ("#6b55d0", "#b0a2ff"),
    ("#8a5a44", "#d6a68f"),
)
COLOURS = len(_PALETTE)
GREY = -1  # of a series with which others are compared
_GREYS = ("#55606e", "#aab4c0")


def _colours(scheme: int) -> str:
    """Style rules of all colours: .s0, .s1 and so on, and .grey."""
    named = [(f"s{i}", pair[scheme]) for i, pair in enumerate(_PALETTE)]
    return " ".join(f".{name} {{ --c: {c}; }}" for name, c in [*named, ("grey", _GREYS[scheme])])


def colour_class(colour: int) -> str:
    """The class of a page's elements whose --c is a series' colour; they repeat after COLOURS."""
    return "grey" if colour == GREY else f"s{colour % COLOURS}"


STYLE = f"""
.chart {{ display: block; width: 100%; height: auto; font: 12px system-ui, sans-serif; }}
.chart text {{ fill: var(--muted); }}
.chart .title {{ fill: var(--text); font-weight: 600; font-size: 13px; }}
.chart .name {{ fill: var(--text); }}
.chart .grid {{ stroke: var(--line); stroke-width: 1; }}
.chart .zero {{ stroke: var(--muted); stroke-width: 1.5; stroke-dasharray: 6 4; }}
.chart .reference {{ stroke: var(--muted); stroke-width: 1.5; }}
.chart .curve {{ fill: none; stroke: var(--c); stroke-width: 2; stroke-linejoin: round; }}
.chart .faint {{ stroke-opacity: .4; }} .chart .thin {{ stroke-width: 1.2; }}
.chart .band {{ fill: var(--c); opacity: .18; }}
.chart .bar {{ stroke: var(--c); stroke-width: 1.5; fill: none; }}
.chart .wide-bar {{ stroke: var(--c); stroke-width: 8; opacity: .35; fill: none; }}
.chart .mark {{ fill: var(--c); stroke: var(--card); stroke-width: 1; }}
{_colours(0)}
@media (prefers-color-scheme: dark) {{ {_colours(1)} }}
"""
_DASHES = ("6 4", "2 3", "12 4", "8 3 2 3")  # of references

LETTER = 6.6  # width of an average character in px, to lay out what we cannot measure
_LEFT, _RIGHT, _BOTTOM, _LINE = 64.0, 18.0, 42.0, 18.0


@dataclass(frozen=True)
class Series:
    """One curve: y over x, NaN where there is no value; with `low` and `high` its spread.

    Its colour is that of its place in the chart, unless it is said: a number, or GREY.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    spread: Literal["band", "bars"] = "band"
    marks: bool = True
    colour: int | None = None
    dashed: bool = False


@dataclass(frozen=True)
class Reference:
    """A dashed horizontal line."""

    label: str
    y: float


def line_chart(
    series: Sequence[Series],
    *,
    title: str,
    x_label: str,
    y_label: str,
    references: Sequence[Reference] = (),
    logarithmic: bool = False,
    x_range: Range | None = None,
    y_range: Range | None = None,
    legend: bool = True,
    width: float = 960.0,
    height: float = 380.0,
) -> str:
    """An `<svg>` of the curves with axes, legend and tooltips.

    Values that are not finite leave gaps, and so do values <= 0 on a logarithmic axis. A chart
    without any value says so. Colours repeat after ten curves, the marks' shapes after four, so
    that twenty curves can be distinguished.

    Args:
        x_range, y_range: what the axes must hold besides the values: charts that are to be
            compared have the same.
    """

    def usable(value: float) -> bool:
        return math.isfinite(value) and (value > 0 or not logarithmic)

    xs = [x for s in series for x in s.x if math.isfinite(x)]
    ys = [y for s in series for part in (s.y, s.low, s.high) for y in part or () if usable(y)]
    ys += [reference.y for reference in references if usable(reference.y)]
    listed, rows = _legend(series, references, width) if legend else ("", 0)
    top = 26.0 + rows * _LINE
    head = (
        f'<svg class="chart" viewBox="0 0 {width:g} {height:g}" role="img"'
        f' aria-label="{on_page(title)}"><title>{on_page(title)}</title>'
        f'<text class="title" x="{_edge(width):g}" y="14">{on_page(title)}</text>'
    )
    if not xs or not ys:
        middle = f'x="{width / 2:g}" y="{height / 2:g}" text-anchor="middle"'
        return f"{head}<text {middle}>no data yet</text></svg>"

    xs, ys = [*xs, *(x_range or ())], [*ys, *filter(usable, y_range or ())]
    x_axis = Axis.linear(min(xs), max(xs), _LEFT + 12, width - _RIGHT - 8, whole=True, fit=True)
    make = Axis.logarithmic if logarithmic else Axis.linear
    y_axis = make(min(ys), max(ys), height - _BOTTOM, top)
    parts = [head, listed]
    for value, text in y_axis.ticks:
        y = y_axis.at(value)
        parts.append(
            f'<line class="grid" x1="{_LEFT:g}" x2="{width - _RIGHT:g}" y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text x="{_LEFT - 8:g}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
        )
    for value, text in x_axis.ticks:
        parts.append(
            f'<text x="{x_axis.at(value):.1f}" y="{height - _BOTTOM + 17:g}"'
            f' text-anchor="middle">{text}</text>'
        )
    centre = (top + height - _BOTTOM) / 2
    parts.append(
        f'<text x="{(_LEFT + width - _RIGHT) / 2:g}" y="{height - 7:g}" text-anchor="middle">'
        f"{on_page(x_label)}</text>"
        f'<text transform="translate(13 {centre:g}) rotate(-90)" text-anchor="middle">'
        f"{on_page(y_label)}</text>"
    )
    for i, reference in enumerate(references):
        if usable(reference.y):
            y = y_axis.at(reference.y)
            parts.append(
                f'<line class="reference" stroke-dasharray="{_DASHES[i % len(_DASHES)]}"'
                f' x1="{_LEFT:g}" x2="{width - _RIGHT:g}" y1="{y:.1f}"'
                f' y2="{y:.1f}"><title>{on_page(reference.label)}: {number(reference.y)}</title>'
                "</line>"
            )
    plots = [_Plot(s, i, x_axis, y_axis, usable) for i, s in enumerate(series)]
    parts += [plot.spread() for plot in plots] + [plot.curve(x_label) for plot in plots]
    return "".join(parts) + "</svg>"


class _Plot:
    """One series on its axes."""

    def __init__(
        self, series: Series, index: int, x: Axis, y: Axis, usable: Callable[[float], bool]
    ) -> None:
        self.series, self.index, self.x, self.y, self.usable = series, index, x, y, usable
        self.colour = colour_class(_colour(series, index))

    def spread(self) -> str:
        s = self.series
        if s.low is None or s.high is None:
            return ""
        if s.spread == "bars":
            return "".join(
                f'<path class="bar {self.colour}" d="M{x - 4:.1f} {low:.1f}h8m-4 0V{high:.1f}'
                f'm-4 0h8"/>'
                for run in self._runs(s.low, s.high)
                for x, low, high in run
            )
        out = []
        for run in self._runs(s.low, s.high):
            edge = [(x, high) for x, _, high in run] + [(x, low) for x, low, _ in reversed(run)]
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in edge)
            out.append(f'<polygon class="band {self.colour}" points="{points}"/>')
        return "".join(out)

    def curve(self, x_label: str) -> str:
        s, out = self.series, [f'<g class="{self.colour}">']
        kind = "curve faint" if s.low is not None and s.spread == "bars" else "curve"
        kind += "" if s.marks else " thin"
        for run in self._runs(s.y, s.y):
            path = "L".join(f"{x:.1f} {y:.1f}" for x, y, _ in run)
            out.append(f'<path class="{kind}"{_dashed(s)} d="M{path}"/>')
        if s.marks:
            for i, (x, y) in enumerate(zip(s.x, s.y, strict=True)):
                if math.isfinite(x) and self.usable(y):
                    text = f"{s.label}, {x_label} {number(x)}: {number(y)}"
                    if s.low is not None and s.high is not None:
                        text += f" ({number(s.low[i])} to {number(s.high[i])})"
                    shape = _mark(self.index, self.x.at(x), self.y.at(y))
                    out.append(f"{shape}<title>{on_page(text)}</title></path>")
        return "".join(out) + "</g>"

    def _runs(
        self, first: Sequence[float], second: Sequence[float]
    ) -> Iterator[list[tuple[float, float, float]]]:
        """Stretches without a gap, in px: (x, first, second)."""
        run: list[tuple[float, float, float]] = []
        for x, a, b in zip(self.series.x, first, second, strict=True):
            if math.isfinite(x) and self.usable(a) and self.usable(b):
                run.append((self.x.at(x), self.y.at(a), self.y.at(b)))
            elif run:
                yield run
                run = []
        if run:
            yield run


def _edge(width: float) -> float:
    """Where title and legend begin: above the plot, or where there is little room further left."""
    return _LEFT if width > 600 else 8.0


def _colour(series: Series, index: int) -> int:
    return index if series.colour is None else series.colour


def _dashed(series: Series) -> str:
    return ' stroke-dasharray="5 4"' if series.dashed else ""


def _mark(index: int, x: float, y: float) -> str:
    """An open `<path>`: circle, square, triangle, diamond."""
    shape = (
        "m-3.8 0a3.8 3.8 0 1 0 7.6 0a3.8 3.8 0 1 0-7.6 0z",
        "m-3.4-3.4h6.8v6.8h-6.8z",
        "m0-4.4l4.2 7.6h-8.4z",
        "m0-4.8l4.4 4.8l-4.4 4.8l-4.4-4.8z",
    )[index % 4]
    return f'<path class="mark" d="M{x:.1f} {y:.1f}{shape}">'


def _legend(
    series: Sequence[Series], references: Sequence[Reference], width: float
) -> tuple[str, int]:
    """The legend's elements and its number of rows."""
    items = [(s.label, i) for i, s in enumerate(series)]
    items += [(r.label, -1 - i) for i, r in enumerate(references)]
    edge = _edge(width)
    out, x, row = [], edge, 1
    for label, index in items:
        space = 46 + LETTER * len(label)
        if x > edge and x + space > width - _RIGHT:
            x, row = edge, row + 1
        y = 14 + row * _LINE
        if index < 0:
            dash = _DASHES[(-1 - index) % len(_DASHES)]
            colour, style = "", f'class="reference" stroke-dasharray="{dash}"'
        else:
            colour = f' class="{colour_class(_colour(series[index], index))}"'
            style = f'class="curve"{_dashed(series[index])}'
        line = f'<path {style} d="M{x:g} {y - 4:g}h26"/>'
        if index >= 0 and series[index].marks:
            line += _mark(index, x + 13, y - 4) + "</path>"
        out.append(f'<g{colour}>{line}<text x="{x + 32:g}" y="{y:g}">{on_page(label)}</text></g>')
        x += space
    return "".join(out), row if items else 0
