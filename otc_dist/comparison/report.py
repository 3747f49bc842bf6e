"""A comparison as a self-contained page, and as JSON for programs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict

from otc_dist.comparison import charts, tables
from otc_dist.comparison.arms import REFERENCE, Arms, describe
from otc_dist.comparison.conclusion import ENOUGH
from otc_dist.comparison.score_statistics import Summary
from otc_dist.comparison.scores import ComparisonFolder, Run, write_json
from otc_dist.description import Description
from otc_dist.report import html
from otc_dist.run.recommendation import reverted
from otc_dist.system import durable
from otc_dist.terminal.printable import on_page


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
    durable.put(folder.report, page(base, arms, summary, runs, label).encode())


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
    if count == 1:
        notices.append(html.notice("One seed.", "What it shows may be chance; no claim."))
    elif count < ENOUGH:
        notices.append(
            html.notice(f"Fewer than {ENOUGH} seeds.", "The intervals are too narrow; no claim.")
        )
    bars = (
        f"Minus {REFERENCE}, seed by seed. Dot: mean; thick bar: 95% bootstrap interval of the"
        " mean; thin bar: by Student's t."
    )
    bands = f"Bands: ± one standard deviation over {count} seeds. Thin line: {REFERENCE}."
    alone = "One seed: it has no spread, and a difference no interval."
    parts = [
        *notices,
        html.section(
            "Result",
            f"<p>{on_page(summary.conclusion)}</p>",
            charts.judged(summary),
            html.note(bars if count > 1 else alone),
            *_judged(summary),
        ),
        html.section(
            "Returns",
            charts.returns(summary),
            html.note(bands if count > 1 else alone),
            *map(html.note, _went_back(base, arms, runs)),
        ),
        html.section(
            f"Return minus that of {REFERENCE}, deployment by deployment",
            charts.differences(summary),
            html.note(tables.METHOD if count > 1 else alone),
        ),
        html.section("In numbers", *(_table(summary, name) for name in tables.measures(summary))),
        html.section("Alpha, mean over seeds", alpha) if (alpha := charts.alpha(runs)) else "",
        html.section("Arms", html.facts((name, ", ".join(a)) for name, a in arms.items())),
        html.section(
            "How it was made",
            html.facts([*_versions(runs), ("processor", tables.processors(runs))]),
            html.details("description.toml", html.preformatted(base.to_toml())),
        ),
    ]
    return html.page(f"Comparison: {base.name}", lead, parts)


def _went_back(base: Description, arms: Arms, runs: Mapping[str, Sequence[Run]]) -> Iterator[str]:
    """Of every arm that may, how often its curve does not go on from the policy before."""
    for name, found in runs.items():
        if describe(base, arms[name], base.seed).deployment.revert:
            told = [one.measured[:k] for one in found for k in range(1, len(one.measured) + 1)]
            back = sum(reverted([x for x in known if x is not None]) is not None for known in told)
            yield (
                f"{name}: after {back} of {len(told)} deployments tuning went back to an earlier"
                " policy, the best deployed so far (deployment.revert)."
            )


def _judged(summary: Summary) -> list[str]:
    """What the runs are judged by: the gains over pi_0, and all paired differences."""
    names, colours = tables.judged(summary), charts.arm_colours(summary)
    found, folded = [], []
    for name in tables.gains(summary):
        rows = list(tables.gain_rows(summary, name))
        found += [
            html.note(tables.GAIN_TITLES[name]),
            html.table(rows[0], rows[1:], colours=colours),
        ]
    for name in names:
        rows = list(tables.difference_rows(summary, name))
        folded.append(html.note(tables.JUDGED_TITLES[name]))
        folded.append(html.table(rows[0], rows[1:], colours=colours))
    if any(one.share is not None for arm in summary.arms for one in arm.judged.values()):
        folded.append(html.note(tables.SHARE))
    title = f"Paired differences from {REFERENCE} in numbers"
    return [*found, html.details(title, *folded, html.note(tables.METHOD))]


def _table(summary: Summary, measure: str) -> str:
    rows = list(tables.measure_rows(summary, measure))
    title = tables.TITLES[measure]
    shown = html.table(rows[0], rows[1:], sums=1, colours=charts.arm_colours(summary))
    return html.details(title[0].upper() + title[1:], shown)


def _versions(runs: Mapping[str, Sequence[Run]]) -> list[tuple[str, str]]:
    """Package -> version; several where runs differ."""
    found: dict[str, set[str]] = {}
    for run in (run for of_arm in runs.values() for run in of_arm):
        for package, version in run.versions.items():
            found.setdefault(package, set()).add(version)
    return [(package, ", ".join(sorted(versions))) for package, versions in found.items()]
