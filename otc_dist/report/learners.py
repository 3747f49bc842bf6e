"""What the learners reported: their samplers before the updates, and their training metrics."""

import math

from otc_dist.description.distances import FITS, SAMPLER_METRICS
from otc_dist.report import html
from otc_dist.report.numbers import NOTHING, column
from otc_dist.report.run_data import RunData
from otc_dist.report.svg import Series, line_chart

_WIDE_RANGE = 20.0  # beyond this ratio of the largest to the smallest, logarithmic axes
_TITLES = {  # of charts and their axes
    "alpha": ("Prioritization strength alpha", "alpha"),
    "similarity": ("Expected similarity 𝔻 (Eq. 4)", "𝔻"),
    "accepted": ("Share of B_k that is accepted", "accepted"),
}
_MOST_POINTS = 300  # of one training curve; more cannot be seen
_WIDTH, _HEIGHT = 420.0, 270.0  # px, of charts beside each other


def sampler_charts(run: RunData) -> str:
    """One a name, by deployment; all have axes of one kind."""
    charts = {name: _sampler_series(run, name) for name in _reported(run)}
    logarithmic = any(map(_wide, charts.values()))
    return html.pair(
        *(
            html.section(
                "",
                line_chart(
                    series,
                    title=_TITLES[name][0],
                    x_label="deployment",
                    y_label=_TITLES[name][1],
                    logarithmic=logarithmic,
                    x_range=(0, run.description.deployment.total),
                    width=_WIDTH,
                    height=_HEIGHT,
                ),
            )
            for name, series in charts.items()
        )
    )


def _reported(run: RunData) -> list[str]:
    """What the samplers gave before the updates."""
    found = {
        name for a in run.agents for tuning in a.tunings.values() for name in tuning.sampler_metrics
    }
    return [name for name in SAMPLER_METRICS if name in found]


def _sampler_series(run: RunData, name: str) -> list[Series]:
    series = []
    for agent in run.agents:
        ks = [k for k in sorted(agent.tunings) if name in agent.tunings[k].sampler_metrics]
        values = [agent.tunings[k].sampler_metrics[name] for k in ks]
        series.append(Series(agent.name, [float(k) for k in ks], values))
    return series


def _wide(series: list[Series]) -> bool:
    usable = [y for s in series for y in s.y if math.isfinite(y)]
    return bool(usable) and min(usable) > 0 and max(usable) / min(usable) > _WIDE_RANGE


def section(run: RunData) -> str:
    """A table of the learners, and charts of their training."""
    if not run.agents:
        return ""
    names, sampler_metrics = [agent.name for agent in run.agents], _reported(run)
    newest = [max(agent.tunings, default=0) for agent in run.agents]
    columns = [
        names,
        [f"{max((max(c) for c in a.curves.get('offline', {}).values() if c), default=0):,}"
         for a in run.agents],
    ]  # fmt: skip
    head = ["agent", "offline updates"]
    if any(agent.curves.get("embedding") for agent in run.agents):
        head.append("active dimensions")
        columns.append(column(a.last("embedding", "active_dimensions") for a in run.agents))
    head.append("tuned on")
    columns.append([str(k) if k else NOTHING for k in newest])
    for name in sampler_metrics:
        head.append(_TITLES[name][1])
        columns.append(
            column(
                agent.tunings[k].sampler_metrics.get(name) if k else None
                for agent, k in zip(run.agents, newest, strict=True)
            )
        )
    charts = [
        html.details(f"Training metrics: {phase}", html.pair(*_metric_charts(run, phase)))
        for phase in ("offline", *FITS, "tuning")
        if any(agent.curves.get(phase) for agent in run.agents)
    ]
    colours = {name: i for i, name in enumerate(names)}
    table = html.table(head, zip(*columns, strict=True), colours=colours)
    return html.section("Learners", table, *charts)


def _metric_charts(run: RunData, phase: str) -> list[str]:
    names = dict.fromkeys(name for agent in run.agents for name in agent.curves.get(phase, {}))
    charts = []
    for name in names:
        if name in SAMPLER_METRICS:  # shown above, by deployment
            continue
        series = []
        for agent in run.agents:
            points = sorted(agent.curves.get(phase, {}).get(name, {}).items())
            if len(points) > 1:
                points = _thinned(points)
                xs, ys = [float(x) for x, _ in points], [y for _, y in points]
                series.append(Series(agent.name, xs, ys, marks=False))
        if series:
            charts.append(
                line_chart(
                    series, title=name, x_label="update", y_label="", width=_WIDTH, height=240
                )
            )
    return charts


def _thinned(points: list[tuple[int, float]]) -> list[tuple[int, float]]:
    step = math.ceil(len(points) / _MOST_POINTS)
    return [*points[:-1:step], points[-1]]
