"""A comparison's charts: one colour an arm, intervals that can be read, and none of one seed."""

import re
from xml.etree import ElementTree

import pytest

from otc_dist.comparison import charts, report
from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.colours import colours
from otc_dist.comparison.picture import picture
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import Run
from otc_dist.description import Description
from otc_dist.report.forest import Row, forest, reach

from .test_statistics import run

ARMS = ("otc-value", "otc-embedding", "rlpd", "online-only", REFERENCE, NULL)


def runs(seeds: int) -> dict[str, list[Run]]:
    return {
        arm: [
            run(arm, seed, 100.0, 110.0 + 30 * place + 7 * seed * place, 120.0 + 20 * place)
            for seed in range(seeds)
        ]
        for place, arm in enumerate(ARMS)
    }


def page(seeds: int) -> str:
    base = Description.build(
        {"name": "made", "env": {"id": "hopper-3x1"}, "dataset": {"name": "medium"}}
    )
    found = runs(seeds)
    arms: dict[str, tuple[str, ...]] = dict.fromkeys(found, ())
    return report.page(base, arms, summarise(found, lambda value: value / 10), found)


def svgs(html: str) -> list[ElementTree.Element]:
    return [ElementTree.fromstring(text) for text in re.findall(r"<svg.*?</svg>", html, re.S)]


def title(chart: ElementTree.Element) -> str:
    return chart.get("aria-label") or ""


def test_every_arm_has_one_colour_everywhere_and_what_all_are_compared_with_is_grey() -> None:
    found = colours(ARMS)
    assert found[REFERENCE] == found[NULL] == -1
    assert sorted(found.values()) == [-1, -1, 0, 1, 2, 3]
    html = page(3)
    small = [chart for chart in svgs(html) if title(chart) in ARMS]
    assert len(small) == len(ARMS) + len(ARMS) - 1  # returns; differences but of the reference
    for chart in small:
        wanted = "grey" if found[title(chart)] == -1 else f"s{found[title(chart)]}"
        assert [g.get("class") for g in chart.iter("g")][-1] == wanted
    for arm, colour in found.items():  # in every table
        dots = re.findall(rf'<span class="dot (\w+)"></span>{arm}</t[dh]>', html)
        assert len(dots) >= 5 and set(dots) == {"grey" if colour == -1 else f"s{colour}"}


def test_bands_are_apart_and_there_are_none_of_one_seed() -> None:
    several = svgs(page(3))
    assert {len(list(chart.iter("polygon"))) for chart in several} == {0, 1}
    assert sum(1 for chart in several if chart.find("polygon") is not None) == len(ARMS)
    html = page(1)
    small = [chart for chart in svgs(html) if title(chart) in ARMS]
    assert len(small) == len(ARMS) - 1  # differences alone
    assert not [chart for chart in svgs(html) if chart.find("polygon") is not None]
    assert 'class="bar' not in html and 'wide-bar"' not in html
    assert "Bands:" not in html and "intervals are too narrow" not in html
    assert "bootstrap interval" not in html.split("<details>")[0]
    assert "One seed: it has no spread, and a difference no interval." in html
    assert "Bands: ± one standard deviation over 3 seeds." in page(3)
    for count, bands in {1: 0, 3: len(ARMS)}.items():
        assert len(list(ElementTree.fromstring(picture(runs(count), "a")).iter(
            "{http://www.w3.org/2000/svg}polygon"))) == bands  # fmt: skip


def test_charts_that_are_compared_have_the_same_axes() -> None:
    summary = summarise(runs(3), lambda value: value / 10)
    for html in (charts.returns(summary), charts.differences(summary)):
        small = [chart for chart in svgs(html) if title(chart) in ARMS]
        assert len({tuple(t.text for t in chart.iter("text"))[1:] for chart in small}) == 1
    wide = [
        chart for chart in svgs(charts.judged(summary)) if "960" in (chart.get("viewBox") or "")
    ]
    ticks = [tuple(t.text for t in chart.iter("text") if t.get("text-anchor") == "middle")
             for chart in wide]  # fmt: skip
    assert len(wide) == 3 and len(set(ticks)) == 1


@pytest.mark.parametrize("width", [360.0, 960.0])
def test_an_interval_lies_where_its_values_say_beside_the_line_of_no_difference(
    width: float,
) -> None:
    nan = float("nan")
    rows = [
        Row("a", 0, 100.0, (50.0, 150.0), (0.0, 200.0)),
        Row("an arm with a very long name <b>", 1, -100.0, (nan, nan), (nan, nan)),
    ]
    chart = ElementTree.fromstring(
        forest(rows, title="t", x_label="x", x_range=reach(rows), width=width)
    )
    (zero,) = (line for line in chart.iter("line") if line.get("class") == "zero")
    x_0 = float(zero.get("x1", ""))
    dots = [float(dot.get("cx", "")) for dot in chart.iter("circle")]
    assert dots[0] - x_0 == pytest.approx(x_0 - dots[1], abs=0.2)
    bars = {path.get("class"): path.get("d", "") for path in chart.iter("path")}
    assert set(bars) == {"bar", "wide-bar"}
    start, stop = map(float, re.findall(r"[MH]([\d.]+)", bars["wide-bar"]))
    assert (start + stop) / 2 == pytest.approx(dots[0], abs=0.2)
    assert stop - start == pytest.approx(dots[0] - x_0, abs=0.2)
    assert float(re.findall(r"M([\d.]+)", bars["bar"])[0]) == pytest.approx(x_0, abs=0.2)
    texts = [text.text for text in chart.iter("text")]
    assert "+100.0" in texts and "an arm with a very long name <b>" in texts
