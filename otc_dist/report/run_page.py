"""`report.html` of one run."""

import math
import shlex
from collections.abc import Mapping
from datetime import datetime

from otc_dist.description.distances import FITS, TOLD
from otc_dist.exploration import Schedule
from otc_dist.report import html, kept
from otc_dist.report.results import QUICK_LABEL, offline_row, rows, tuned
from otc_dist.report.returns import percent, returns_table, signed
from otc_dist.report.run_data import RunData
from otc_dist.report.svg import NOTHING, Reference, Series, line_chart, number

_WIDE_RANGE = 20.0  # beyond this ratio of the largest to the smallest, a logarithmic axis
_TITLES = {  # of charts and their axes
    "alpha": ("Prioritization strength alpha", "alpha"),
    "similarity": ("Expected similarity 𝔻 (Eq. 4)", "𝔻"),
    "accepted": ("Share of B_k that is accepted", "accepted"),
}
_MOST_POINTS = 300  # of one training curve; more cannot be seen


def render(run: RunData) -> str:
    """The page."""
    d, told = run.description, kept.recommended(run)
    lead = " · ".join(
        part
        for part in (
            d.heading,
            f"seed {d.seed}",
            str(run.record.get("run") or run.folder.root.name),
            _moment(run.record.get("started")),
            f"recommended: {kept.named(told)}" if told else "",
        )
        if part
    )
    return html.page(
        d.name,
        lead,
        [
            *_notices(run),
            _figures(run),
            html.section("", _learning_curve(run)),
            kept.section(run),
            html.pair(*(html.section("", _told_chart(run, name)) for name in _told(run))),
            returns_table(run),
            _learners(run),
            _dataset(run),
            _provenance(run),
        ],
    )


def _notices(run: RunData) -> list[str]:
    notices = []
    if run.quick:
        notices.append(
            html.notice(
                f"{QUICK_LABEL[0].upper()}{QUICK_LABEL[1:]}.",
                "Every part of the system ran, far too briefly to learn anything.",
            )
        )
    if not run.complete:
        count, state = run.description.deployment.total, run.record.get("state")
        notices.append(
            html.notice(
                "This run is not complete.",
                f"{run.deployments} of {count} deployments and {len(run.evaluations)} evaluations"
                f" so far{f'; its state is {state!r}' if state else ''}.",
            )
        )
    if ended := kept.stopped(run):
        notices.append(html.notice("Deployments ended early:", f"{ended['reason']}."))
    if run.problems:
        notices.append(html.notice("Not in this report:", "; ".join(run.problems) + "."))
    return notices


def _figures(run: RunData) -> str:
    offline, after = offline_row(run), tuned(run)
    items = []
    if offline:
        items.append((number(offline.returns.mean), "offline return, mean of pi_0"))
    if told := kept.recommended(run):
        greedy = kept.greedy_return(run, int(str(told["policy"])))
        if greedy is not None:
            items.append((number(greedy), f"return of {kept.named(told)}: recommended"))
    if after:
        items += [
            (number(after.last.returns.mean), f"return after deployment {after.last.deployment}"),
            (number(after.mean_return), "return, mean over deployments"),
            (signed(after.improvement, " %"), "improvement, mean over deployments"),
        ]
        if after.gain is not None:
            items.append((signed(after.gain), "normalised score gained, mean over deployments"))
        if after.mean_success is not None:
            items.append((percent(after.mean_success), "episodes won, mean over deployments"))
    schedule = Schedule.of(run.description, len(run.agents))
    if schedule.rounds > 1:
        cost = schedule.steps * run.description.env.copies
        items.append((f"{cost:,}", f"transitions a deployment: M x {schedule.rounds} explorers"))
    if run.wall_seconds is not None:
        items.append((_duration(run.wall_seconds), "wall time"))
    return html.figures(items) if items else ""


def _learning_curve(run: RunData) -> str:
    table, offline = rows(run), offline_row(run)
    means = [row.returns.mean for row in table]
    chart = line_chart(
        [
            Series(
                "mean return, ±1 standard deviation of episodes",
                [float(row.deployment) for row in table],
                means,
                [row.returns.mean - row.returns.std for row in table],
                [row.returns.mean + row.returns.std for row in table],
            )
        ],
        title="Return over deployments",
        x_label="deployment",
        y_label="return of greedy episodes",
        references=[Reference("offline", offline.returns.mean)] if offline else [],
    )
    episodes = run.description.evaluation.episodes
    return chart + html.note(
        f"Deployment 0 is the policy trained offline. {episodes} greedy episodes each, apart from"
        " the transitions that the agents learn from. The band is of episodes; one run with one"
        " seed does not tell how much runs differ."
    )


def _told(run: RunData) -> list[str]:
    """What the samplers gave before the updates."""
    found = {name for a in run.agents for tuning in a.tunings.values() for name in tuning.told}
    return [name for name in TOLD if name in found]


def _told_chart(run: RunData, name: str) -> str:
    title, label = _TITLES[name]
    series = []
    for agent in run.agents:
        ks = [k for k in sorted(agent.tunings) if name in agent.tunings[k].told]
        values = [agent.tunings[k].told[name] for k in ks]
        series.append(Series(agent.name, [float(k) for k in ks], values))
    usable = [y for s in series for y in s.y if math.isfinite(y)]
    wide = bool(usable) and min(usable) > 0 and max(usable) / min(usable) > _WIDE_RANGE
    return line_chart(
        series,
        title=title,
        x_label="deployment",
        y_label=label,
        logarithmic=wide,
        width=480,
        height=300,
    )


def _learners(run: RunData) -> str:
    if not run.agents:
        return ""
    lines, told = [], _told(run)
    embedded = any(agent.curves.get("embedding") for agent in run.agents)
    for agent in run.agents:
        active, newest = agent.last("embedding", "active_dimensions"), max(agent.tunings, default=0)
        tuning = agent.tunings[newest].told if newest else {}
        offline = max((max(c) for c in agent.curves.get("offline", {}).values() if c), default=0)
        lines.append(
            [
                agent.name,
                f"{offline:,}",
                *[number(active) if active is not None else NOTHING] * embedded,
                str(newest),
                *(number(tuning[name]) if name in tuning else NOTHING for name in told),
            ]
        )
    active_column = ["active dimensions"] * embedded
    labels = [_TITLES[name][1] for name in told]
    head = ["agent", "offline updates", *active_column, "tuned on", *labels]
    charts = [
        html.details(f"Training metrics: {phase}", html.pair(*_metric_charts(run, phase)))
        for phase in ("offline", *FITS, "tuning")
        if any(agent.curves.get(phase) for agent in run.agents)
    ]
    return html.section("Learners", html.table(head, lines), *charts)


def _metric_charts(run: RunData, phase: str) -> list[str]:
    names = dict.fromkeys(name for agent in run.agents for name in agent.curves.get(phase, {}))
    charts = []
    for name in names:
        if name in TOLD:  # shown above, by deployment
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
                line_chart(series, title=name, x_label="update", y_label="", width=480, height=240)
            )
    return charts


def _thinned(points: list[tuple[int, float]]) -> list[tuple[int, float]]:
    step = math.ceil(len(points) / _MOST_POINTS)
    return [*points[:-1:step], points[-1]]


def _dataset(run: RunData) -> str:
    dataset = run.description.dataset
    if run.card is None:
        size = f"{dataset.transitions:,}" if dataset.transitions else "its usual size"
        return html.section("Data set B_0", html.facts([(dataset.name, size)]))
    brief: dict[str, object] = {}
    long: dict[str, object] = {}
    for key, value in run.card.items():
        nested = isinstance(value, list) or (isinstance(value, dict) and "mean" not in value)
        (long if nested else brief)[key] = value
    return html.section(
        "Data set B_0",
        html.facts(_flat(brief)),
        html.details("Recipe, notes, versions, files", html.facts(_flat(long))) if long else "",
    )


def _provenance(run: RunData) -> str:
    command = run.record.get("command")
    line = shlex.join(map(str, command)) if isinstance(command, list) else str(command or "unknown")
    versions = run.record.get("versions")
    items = [
        ("description digest", run.description.digest()),
        ("seed", str(run.description.seed)),
        *([("pi_0 was taken from", str(origin))] if (origin := run.record.get("origin")) else []),
        ("started", _moment(run.record.get("started")) or "unknown"),
        ("wall time", _duration(run.wall_seconds) if run.wall_seconds is not None else "unknown"),
    ]
    resumed = run.record.get("resumed")
    extended = run.record.get("extended")
    if isinstance(extended, list) and extended:
        items.append(("extended to deployments", ", ".join(map(str, extended))))
    if isinstance(resumed, list) and resumed:
        items.append(("resumed (pauses count as wall time)", ", ".join(map(_moment, resumed))))
    return html.section(
        "How this came about",
        html.preformatted(line),
        html.facts([*items, *(_flat(versions) if isinstance(versions, dict) else [])]),
        html.details("Description", html.preformatted(run.description.to_toml())),
    )


def _flat(data: Mapping[str, object], above: str = "") -> list[tuple[str, str]]:
    """Nested facts as (path, text)."""
    items: list[tuple[str, str]] = []
    for key, value in data.items():
        name = f"{above} · {key}" if above else key.replace("_", " ")
        if isinstance(value, dict) and {"mean", "std", "minimum", "maximum"} == value.keys():
            mean, std, low, high = (number(value[k]) for k in ("mean", "std", "minimum", "maximum"))
            items.append((name, f"{mean} ± {std} ({low} … {high})"))
        elif isinstance(value, dict):
            items += _flat(value, name)
        elif isinstance(value, list):
            items.append((name, "; ".join(map(str, value)) or "none"))
        elif isinstance(value, float):
            items.append((name, number(value)))
        elif isinstance(value, int) and not isinstance(value, bool):
            items.append((name, f"{value:,}"))
        else:
            items.append((name, NOTHING if value is None else str(value)))
    return items


def _moment(text: object) -> str:
    """A date of run.json without its fractions of a minute; what is none stays as it is."""
    try:
        return datetime.fromisoformat(str(text)).strftime("%Y-%m-%d %H:%M %Z").strip()
    except ValueError:
        return str(text or "")


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
