"""Charts: the points lie where their values say, gaps stay gaps, and any input gives a chart."""

import math
import re
from itertools import pairwise
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from otc_dist.report.svg import Reference, Series, line_chart, number


def chart(*series: Series, **options: object) -> ElementTree.Element:
    """The chart, parsed: it is well-formed XML."""
    labels = {"title": "a title", "x_label": "deployment", "y_label": "return"}
    return ElementTree.fromstring(line_chart(series, **labels, **options))


def marks(root: ElementTree.Element, index: int = 0) -> list[tuple[float, float]]:
    """Positions of a series' marks that carry a tooltip: those in the plot."""
    groups = [g for g in root.iter("g") if g.find("path[@class='mark']/title") is not None]
    return [
        tuple(map(float, re.match(r"M([-\d.]+) ([-\d.]+)", path.get("d", "")).groups()))
        for path in groups[index].iter("path")
        if path.find("title") is not None
    ]


def texts(root: ElementTree.Element) -> list[str]:
    return [element.text or "" for element in root.iter("text")]


def test_points_lie_where_their_values_say() -> None:
    points = marks(chart(Series("a", [0, 1, 2, 4], [0, 10, 5, 20])))
    xs, ys = zip(*points, strict=True)
    assert (xs[3] - xs[0]) == pytest.approx(4 * (xs[1] - xs[0]), abs=0.3)
    # Upwards is smaller in SVG.
    assert (ys[0] - ys[3]) == pytest.approx(2 * (ys[0] - ys[1]), abs=0.3)
    assert (ys[0] - ys[1]) == pytest.approx(2 * (ys[0] - ys[2]), abs=0.3)


def test_equal_ratios_are_equal_distances_on_a_logarithmic_axis() -> None:
    points = marks(chart(Series("a", [0, 1, 2, 3], [0.1, 1, 10, 0]), logarithmic=True))
    assert len(points) == 3  # zero has no place there
    ys = [y for _, y in points]
    assert ys[0] - ys[1] == pytest.approx(ys[1] - ys[2], abs=0.3)


def test_a_gap_stays_a_gap() -> None:
    nan = math.nan
    root = chart(
        Series("a", [0, 1, 2, 3, 4], [1, 2, nan, 4, 5], [0, 1, nan, 3, 4], [2, 3, nan, 5, 6])
    )
    assert len(marks(root)) == 4
    assert len(list(root.iter("polygon"))) == 2
    curves = [p for p in root.iter("path") if p.get("class") == "curve" and "L" in p.get("d", "")]
    assert len(curves) == 2


def test_intervals_as_bars_and_a_reference() -> None:
    root = chart(
        Series("a", [0, 1], [1, 2], [0, 1], [2, 3], spread="bars"),
        references=[Reference("zero", 0)],
    )
    assert len([p for p in root.iter("path") if "bar" in (p.get("class") or "").split()[0]]) == 2
    lines = [line for line in root.iter("line") if line.get("class") == "reference"]
    assert len(lines) == 1 and "zero" in texts(root)
    assert "a, deployment 1: 2 (1 to 3)" in [t.text for t in root.iter("title")]


def test_a_long_legend_takes_more_lines() -> None:
    series = [Series(f"an arm with a long name {i}", [0, 1], [i, i]) for i in range(12)]
    root = chart(*series)
    rows = {t.get("y") for t in root.iter("text") if "an arm" in (t.text or "")}
    assert len(rows) > 1
    shapes = {
        (g.get("class"), g.findall("path")[1].get("d", "").split("m", 1)[1])
        for g in root.iter("g")
        if len(g.findall("path")) == 2 and g.find("text") is not None
    }
    assert len(shapes) == 12  # each told apart by colour and shape


def test_nothing_to_draw() -> None:
    for root in (chart(), chart(Series("a", [], [])), chart(Series("a", [0], [math.nan]))):
        assert "no data yet" in texts(root)


def test_markup_in_labels_is_text() -> None:
    assert "<b>&" in texts(chart(Series("<b>&", [0, 1], [0, 1])))


def test_ticks_of_deployments_are_whole_numbers() -> None:
    root = chart(Series("a", [0, 1], [0.25, 0.75]))
    below = [t.text for t in root.iter("text") if t.get("y") == "355"]
    assert below == ["0", "1"]


@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=1, max_size=8),
    st.booleans(),
)
def test_any_values_give_a_chart_inside_its_frame(values: list[float], logarithmic: bool) -> None:
    root = chart(Series("a", [float(i) for i in range(len(values))], values),
                 logarithmic=logarithmic)  # fmt: skip
    drawn = [v for v in values if math.isfinite(v) and (v > 0 or not logarithmic)]
    if not drawn:
        return
    points = marks(root)
    assert len(points) == len(drawn)
    assert all(0 <= x <= 960 and 0 <= y <= 380 for x, y in points)
    for (a, (_, y)), (b, (_, z)) in pairwise(zip(drawn, points, strict=True)):
        assert (y >= z) if a <= b else (y <= z)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"), (7.0, "7"), (1234.5, "1,234"), (-0.5, "\N{MINUS SIGN}0.5000"),
        (0.01234, "0.0123"), (1e-9, "1.00e-09"), (math.nan, "\N{EN DASH}"), (66.6666, "66.67"),
    ],
)  # fmt: skip
def test_numbers_for_reading(value: float, text: str) -> None:
    assert number(value) == text
