"""Line charts as SVG text: no script, nothing external, colours from the page's style sheet.

`STYLE` belongs into the page once; the charts then follow its light or dark scheme.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

STYLE = """
.chart { display: block; width: 100%; min-width: 400px; height: auto;
  font: 12px system-ui, sans-serif; }
.chart text { fill: var(--muted); }
.chart .title { fill: var(--text); font-weight: 600; font-size: 13px; }
.chart .grid { stroke: var(--line); stroke-width: 1; }
.chart .reference { stroke: var(--muted); stroke-width: 1.5; stroke-dasharray: 6 4; }
.chart .curve { fill: none; stroke: var(--c); stroke-width: 2; stroke-linejoin: round; }
.chart .faint { stroke-opacity: .4; }
.chart .band { fill: var(--c); opacity: .15; }
.chart .bar { stroke: var(--c); stroke-width: 1.5; fill: none; }
.chart .mark { fill: var(--c); stroke: var(--card); stroke-width: 1; }
.chart .s0 { --c: #2563c9; } .chart .s1 { --c: #c8501e; } .chart .s2 { --c: #17826a; }
.chart .s3 { --c: #9a3fa0; } .chart .s4 { --c: #9a7200; } .chart .s5 { --c: #55606e; }
@media (prefers-color-scheme: dark) {
.chart .s0 { --c: #74a7ff; } .chart .s1 { --c: #ff9466; } .chart .s2 { --c: #4fd0ae; }
.chart .s3 { --c: #dd92e3; } .chart .s4 { --c: #e3bd4a; } .chart .s5 { --c: #aab4c0; }
}
"""
_COLOURS = 6

NOTHING = "\N{EN DASH}"  # stands where there is no value
MINUS = "\N{MINUS SIGN}"

_LETTER = 6.6  # width of an average character in px, to lay out what we cannot measure
_LEFT, _RIGHT, _BOTTOM, _LINE = 64.0, 18.0, 42.0, 18.0


@dataclass(frozen=True)
class Series:
    """One curve: y over x, NaN where there is no value; with `low` and `high` its spread."""

    label: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    spread: Literal["band", "bars"] = "band"
    marks: bool = True


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
    width: float = 960.0,
    height: float = 380.0,
) -> str:
    """An `<svg>` of the curves with axes, legend and tooltips.

    Values that are not finite leave gaps, and so do values <= 0 on a logarithmic axis. A chart
    without any value says so. Colours repeat after six curves, the marks' shapes after four, so
    that twelve curves can be told apart.
    """

    def usable(value: float) -> bool:
        return math.isfinite(value) and (value > 0 or not logarithmic)

    xs = [x for s in series for x in s.x if math.isfinite(x)]
    ys = [y for s in series for part in (s.y, s.low, s.high) for y in part or () if usable(y)]
    ys += [reference.y for reference in references if usable(reference.y)]
    legend, rows = _legend(series, references, width)
    top = 26.0 + rows * _LINE
    head = (
        f'<svg class="chart" viewBox="0 0 {width:g} {height:g}" role="img"'
        f' aria-label="{escape(title)}"><title>{escape(title)}</title>'
        f'<text class="title" x="{_LEFT:g}" y="14">{escape(title)}</text>'
    )
    if not xs or not ys:
        middle = f'x="{width / 2:g}" y="{height / 2:g}" text-anchor="middle"'
        return f"{head}<text {middle}>no data yet</text></svg>"

    x_axis = _Axis.linear(min(xs), max(xs), _LEFT + 12, width - _RIGHT - 8, whole=True, fit=True)
    make = _Axis.logarithmic if logarithmic else _Axis.linear
    y_axis = make(min(ys), max(ys), height - _BOTTOM, top)
    parts = [head, legend]
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
        f"{escape(x_label)}</text>"
        f'<text transform="translate(13 {centre:g}) rotate(-90)" text-anchor="middle">'
        f"{escape(y_label)}</text>"
    )
    for reference in references:
        if usable(reference.y):
            y = y_axis.at(reference.y)
            parts.append(
                f'<line class="reference" x1="{_LEFT:g}" x2="{width - _RIGHT:g}" y1="{y:.1f}"'
                f' y2="{y:.1f}"><title>{escape(reference.label)}: {number(reference.y)}</title>'
                "</line>"
            )
    plots = [_Plot(s, i, x_axis, y_axis, usable) for i, s in enumerate(series)]
    parts += [plot.spread() for plot in plots] + [plot.curve(x_label) for plot in plots]
    return "".join(parts) + "</svg>"


def number(value: float) -> str:
    """For reading: four significant digits or a whole number, thousands separated."""
    if not math.isfinite(value):
        return NOTHING
    if value == round(value) and abs(value) < 1e9:
        return f"{value:,.0f}".replace("-", MINUS)
    digits = max(0, 3 - math.floor(math.log10(abs(value))))
    if digits > 6:
        return f"{value:.2e}"
    return f"{value:,.{min(digits, 4)}f}".replace("-", MINUS)


class _Plot:
    """One series on its axes."""

    def __init__(
        self, series: Series, index: int, x: "_Axis", y: "_Axis", usable: Callable[[float], bool]
    ) -> None:
        self.series, self.index, self.x, self.y, self.usable = series, index, x, y, usable
        self.colour = f"s{index % _COLOURS}"

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
        for run in self._runs(s.y, s.y):
            path = "L".join(f"{x:.1f} {y:.1f}" for x, y, _ in run)
            out.append(f'<path class="{kind}" d="M{path}"/>')
        if s.marks:
            for i, (x, y) in enumerate(zip(s.x, s.y, strict=True)):
                if math.isfinite(x) and self.usable(y):
                    text = f"{s.label}, {x_label} {number(x)}: {number(y)}"
                    if s.low is not None and s.high is not None:
                        text += f" ({number(s.low[i])} to {number(s.high[i])})"
                    shape = _mark(self.index, self.x.at(x), self.y.at(y))
                    out.append(f"{shape}<title>{escape(text)}</title></path>")
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
    items = [(s.label, i) for i, s in enumerate(series)] + [(r.label, -1) for r in references]
    out, x, row = [], _LEFT, 1
    for label, index in items:
        space = 46 + _LETTER * len(label)
        if x > _LEFT and x + space > width - _RIGHT:
            x, row = _LEFT, row + 1
        y = 14 + row * _LINE
        kind = "reference" if index < 0 else "curve"
        line = f'<path class="{kind}" d="M{x:g} {y - 4:g}h26"/>'
        if index >= 0 and series[index].marks:
            line += _mark(index, x + 13, y - 4) + "</path>"
        out.append(
            f'<g class="s{index % _COLOURS}">{line}<text x="{x + 32:g}" y="{y:g}">'
            f"{escape(label)}</text></g>"
        )
        x += space
    return "".join(out), row if items else 0


@dataclass(frozen=True)
class _Axis:
    """From values to px, with ticks (value, text)."""

    low: float
    high: float
    start: float
    stop: float
    ticks: list[tuple[float, str]]
    log: bool = False

    def at(self, value: float) -> float:
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
    ) -> "_Axis":
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
    def logarithmic(cls, low: float, high: float, start: float, stop: float) -> "_Axis":
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
