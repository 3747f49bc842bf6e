"""A comparison as a self-contained page, and as JSON for programs."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape

import numpy as np

from otc_dist.comparison import tables
from otc_dist.comparison.arms import REFERENCE, Arms
from otc_dist.comparison.conclusion import ENOUGH
from otc_dist.comparison.judgement import RECOMMENDED
from otc_dist.comparison.scores import ComparisonFolder, Run, write_json
from otc_dist.comparison.statistics import Summary
from otc_dist.description import Description
from otc_dist.errors import UserError
from otc_dist.report import html
from otc_dist.report.svg import Reference, Series, line_chart


def write(
    folder: ComparisonFolder,
    base: Description,
    arms: Arms,
    summary: Summary,
    runs: Mapping[str, Sequence[Run]],
    label: str = "",
) -> None:
    """Write comparison.json and comparison.html. `label` is shown where it is no real result."""
    facts = {
        "description": base.digest(),
        "label": label,
        "arms": {name: list(assignments) for name, assignments in arms.items()},
        "method": tables.METHOD,
        **asdict(summary),
    }
    write_json(folder.results, facts)
    try:
        folder.report.write_text(page(base, arms, summary, runs, label), encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {folder.report}: {error.strerror}") from None


def page(
    base: Description,
    arms: Arms,
    summary: Summary,
    runs: Mapping[str, Sequence[Run]],
    label: str = "",
) -> str:
    """The HTML document."""
    count = len(summary.seeds)
    lead = (
        f"{base.dataset.name}: {count} {'seed' if count == 1 else 'seeds'}"
        f" ({', '.join(map(str, summary.seeds))}), {summary.episodes} greedy episodes each"
    )
    notices = [html.notice(f"This is {label}.", "Sizes are far below a run's.")] if label else []
    if count < ENOUGH:
        notices.append(
            html.notice(f"Fewer than {ENOUGH} seeds.", "The intervals are too narrow; no claim.")
        )
    conclusion = f"<p>{escape(summary.conclusion)}</p>"
    parts = [
        *notices,
        html.section("Result", conclusion, *_judged(summary), html.note(tables.METHOD)),
        html.section("Returns", _curves(summary), html.note("Bands: ± one standard deviation.")),
        html.section(
            f"Paired differences from {REFERENCE}", _differences(summary), html.note(tables.METHOD)
        ),
        *(_table(summary, measure) for measure in tables.measures(summary)),
        _alpha(runs),
        html.section("Arms", html.facts((name, ", ".join(a)) for name, a in arms.items())),
        html.section(
            "How it was made",
            html.facts([*_versions(runs), ("processor", tables.processors(runs))]),
            html.details("description.toml", html.preformatted(base.to_toml())),
        ),
    ]
    return html.page(f"Comparison: {base.name}", lead, parts)


def _curves(summary: Summary) -> str:
    series = []
    for arm in summary.arms:
        found = arm.measures["return"].deployments
        series.append(
            Series(
                tables.label(arm),
                list(range(len(found))),
                [spread.mean for spread in found],
                [spread.mean - spread.std for spread in found],
                [spread.mean + spread.std for spread in found],
            )
        )
    return line_chart(
        series, title="Return of pi_k", x_label="deployment", y_label="return", height=420
    )


def _differences(summary: Summary) -> str:
    """Of every arm at every deployment, with intervals."""
    arms = [arm for arm in summary.arms if arm.differences]
    series = []
    for index, arm in enumerate(arms):
        found = arm.differences
        # Side by side, so that the bars can be seen.
        shift = 0.12 * (index - (len(arms) - 1) / 2)
        series.append(
            Series(
                tables.label(arm),
                [k + shift for k in range(1, len(found) + 1)],
                [d.mean for d in found],
                [d.low for d in found],
                [d.high for d in found],
                spread="bars",
            )
        )
    return line_chart(
        series,
        title=f"Return minus that of {REFERENCE}",
        x_label="deployment",
        y_label="difference in return",
        references=[Reference("no difference", 0.0)],
    )


def _judged(summary: Summary) -> list[str]:
    """What the runs are judged by: the recommended policy's gain, and all paired differences."""
    names = tables.judged(summary)
    found = []
    if RECOMMENDED in names:
        gains = list(tables.gain_rows(summary))
        found += [html.note(tables.GAIN), html.table(gains[0], gains[1:])]
    for name in names:
        rows = list(tables.difference_rows(summary, name))
        found += [html.note(tables.JUDGED_TITLES[name]), html.table(rows[0], rows[1:])]
    if any(one.share is not None for arm in summary.arms for one in arm.judged.values()):
        found.append(html.note(tables.SHARE))
    return found


def _table(summary: Summary, measure: str) -> str:
    rows = list(tables.measure_rows(summary, measure))
    title = tables.TITLES[measure]
    return html.section(title[0].upper() + title[1:], html.table(rows[0], rows[1:], sums=1))


def _alpha(runs: Mapping[str, Sequence[Run]]) -> str:
    """Alpha of every agent, mean over seeds, for the arms that have one."""
    charts = []
    for name, found in runs.items():
        mine = [run for run in found if all("alpha" in of for of in run.told[0].values())]
        if not mine:
            continue
        series = []
        for agent in mine[0].told[0]:
            alphas = [[of[agent]["alpha"] for of in run.told] for run in mine]
            values = np.asarray(alphas, np.float64).mean(axis=0)
            series.append(Series(agent, list(range(1, len(values) + 1)), values.tolist()))
        charts.append(
            line_chart(series, title=f"alpha, {name}", x_label="deployment", y_label="alpha")
        )
    return html.section("Alpha, mean over seeds", html.pair(*charts)) if charts else ""


def _versions(runs: Mapping[str, Sequence[Run]]) -> list[tuple[str, str]]:
    """Package -> version; several where runs differ."""
    found: dict[str, set[str]] = {}
    for run in (run for of_arm in runs.values() for run in of_arm):
        for package, version in run.versions.items():
            found.setdefault(package, set()).add(version)
    return [(package, ", ".join(sorted(versions))) for package, versions in found.items()]
