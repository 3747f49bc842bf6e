"""The charts of a comparison's page: every arm has one colour in all of them."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from otc_dist.comparison import tables
from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.colours import colours
from otc_dist.comparison.score_statistics import Arm, Summary
from otc_dist.comparison.scores import Run
from otc_dist.report import html
from otc_dist.report.axes import Range
from otc_dist.report.forest import Row, forest, reach
from otc_dist.report.svg import Reference, Series, line_chart

_WIDTH, _HEIGHT = 320.0, 210.0  # px, of a small chart


def arm_colours(summary: Summary) -> Mapping[str, int]:
    """By the arms' labels."""
    found = colours(arm.name for arm in summary.arms)
    return {tables.label(arm): found[arm.name] for arm in summary.arms}


def judged(summary: Summary) -> str:
    """Of each number that runs are judged by, all arms' paired differences from the reference."""
    by_label = arm_colours(summary)
    rows = {name: _rows(summary, name, by_label) for name in tables.judged(summary)}
    x_range = reach([row for of_name in rows.values() for row in of_name])

    def drawn(name: str) -> str:
        title, axis = tables.SHORT_TITLES[name], f"return minus {REFERENCE}'s"
        return html.chart(
            lambda width, _: forest(
                rows[name], title=title, x_label=axis, x_range=x_range, width=width
            )
        )

    return "".join(drawn(name) for name in rows if rows[name])


def _rows(summary: Summary, name: str, by_label: Mapping[str, int]) -> list[Row]:
    rows = []
    for arm in tables.null_last(summary):
        one = arm.judged[name].difference if name in arm.judged else None
        if one is not None:
            label, wide = tables.label(arm), (one.t_low, one.t_high)
            rows.append(Row(label, by_label[label], one.mean, (one.low, one.high), wide))
    return rows


def returns(summary: Summary) -> str:
    """Mean returns of all arms in one chart, and of several seeds each arm's spread in its own."""
    by_label = arm_colours(summary)
    means = [_mean(arm, by_label) for arm in summary.arms]
    whole = html.chart(
        lambda width, height: line_chart(
            means,
            title="Mean return of pi_k",
            x_label="deployment",
            y_label="return",
            width=width,
            height=height,
        ),
        height=420,
    )
    spread = [_spread(arm, by_label) for arm in summary.arms]
    limits = _limits(spread)
    if all(series.low is None for series in spread):
        return whole
    reference = _plain(_mean(summary.arm(REFERENCE), by_label))
    small = [
        line_chart(
            [series] if series.label == reference.label else [reference, series],
            title=series.label,
            x_label="deployment",
            y_label="return",
            y_range=limits,
            legend=False,
            width=_WIDTH,
            height=_HEIGHT,
        )
        for series in spread
    ]
    return whole + html.charts(small)


def differences(summary: Summary) -> str:
    """Of every arm from the reference at every deployment, each in a chart of its own."""
    by_label = arm_colours(summary)
    found = []
    for arm in tables.null_last(summary):
        if arm.differences:
            label, many = tables.label(arm), len(arm.seeds) > 1
            found.append(
                Series(
                    label,
                    list(range(1, len(arm.differences) + 1)),
                    [d.mean for d in arm.differences],
                    [d.low for d in arm.differences] if many else None,
                    [d.high for d in arm.differences] if many else None,
                    spread="bars",
                    colour=by_label[label],
                    dashed=arm.name == NULL,
                )
            )
    limits = _limits(found)
    return html.charts(
        line_chart(
            [series],
            title=series.label,
            x_label="deployment",
            y_label=f"minus {REFERENCE}",
            references=[Reference("no difference", 0.0)],
            y_range=limits,
            legend=False,
            width=_WIDTH,
            height=_HEIGHT,
        )
        for series in found
    )


def alpha(runs: Mapping[str, Sequence[Run]]) -> str:
    """Alpha of every agent, mean over seeds, for the arms that have one; "" without any."""
    found: dict[str, list[Series]] = {}
    by_arm = colours(runs)
    for name, of_arm in runs.items():
        tuned = [run for run in of_arm if run.told]
        mine = [run for run in tuned if all("alpha" in of for of in run.told[0].values())]
        if not mine:
            continue
        found[name] = []
        for place, agent in enumerate(mine[0].told[0]):
            alphas = [[of[agent]["alpha"] for of in run.told] for run in mine]
            values = np.asarray(alphas, np.float64).mean(axis=0)
            x = list(range(1, len(values) + 1))
            dashed = place % 2 == 1
            one = Series(agent, x, values.tolist(), colour=by_arm[name], dashed=dashed)
            found[name].append(one)
    limits = _limits([series for of_arm in found.values() for series in of_arm])
    return html.charts(
        line_chart(
            series,
            title=name,
            x_label="deployment",
            y_label="alpha",
            y_range=limits,
            width=_WIDTH,
            height=_HEIGHT,
        )
        for name, series in found.items()
    )


def _mean(arm: Arm, by_label: Mapping[str, int]) -> Series:
    found, label = arm.measures["return"].deployments, tables.label(arm)
    means = [spread.mean for spread in found]
    x = list(range(len(found)))
    return Series(label, x, means, colour=by_label[label], dashed=arm.name == NULL)


def _spread(arm: Arm, by_label: Mapping[str, int]) -> Series:
    """With a band of ± one standard deviation over seeds, unless there is but one."""
    found, mean = arm.measures["return"].deployments, _mean(arm, by_label)
    if len(arm.seeds) < 2:
        return mean
    low, high = zip(*(spread.band for spread in found), strict=True)
    return Series(mean.label, mean.x, mean.y, low, high, colour=mean.colour, dashed=mean.dashed)


def _plain(series: Series) -> Series:
    """A thin line, with which another is compared."""
    return Series(series.label, series.x, series.y, marks=False, colour=series.colour)


def _limits(series: Sequence[Series]) -> Range | None:
    values = [y for s in series for part in (s.y, s.low, s.high) for y in part or ()]
    finite = [y for y in values if math.isfinite(y)]
    return (min(finite), max(finite)) if finite else None
