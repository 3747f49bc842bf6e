"""`report.html` of one run."""

import shlex
from collections.abc import Mapping
from datetime import datetime

from otc_dist.report import html, kept, learners
from otc_dist.report.numbers import NOTHING, number, percent, signed
from otc_dist.report.results import QUICK_LABEL, offline_row, tuned
from otc_dist.report.returns import learning_curve, returns_table
from otc_dist.report.run_data import RunData
from otc_dist.report.verdict import verdict
from otc_dist.run.exploration import Schedule
from otc_dist.terminal.amounts import duration


def render(run: RunData) -> str:
    """The page."""
    d, recommended, found = run.description, kept.recommended(run), verdict(run)
    lead = " · ".join(
        part
        for part in (
            d.heading,
            f"seed {d.seed}",
            str(run.record.get("run") or run.folder.root.name),
            _moment(run.record.get("started")),
            f"recommended: {kept.named(recommended)}" if recommended else "",
        )
        if part
    )
    return html.page(
        d.name,
        lead,
        [
            html.verdict(found.tone, found.sentence, found.more),
            *_notices(run),
            _figures(run),
            html.section("", learning_curve(run)),
            kept.section(run),
            learners.sampler_charts(run),
            returns_table(run),
            learners.section(run),
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
    if recommended := kept.recommended(run):
        greedy = kept.greedy_return(run, int(str(recommended["policy"])))
        if greedy is not None:
            items.append((number(greedy), f"return of {kept.named(recommended)}: recommended"))
    if after:
        items += [
            (number(after.last.returns.mean), f"return after deployment {after.last.deployment}"),
            (number(after.mean_return), "return, mean over deployments"),
            (signed(after.improvement, " %"), "change from offline, mean over deployments"),
        ]
        if after.gain is not None:
            items.append((signed(after.gain), "change in normalised score, mean over deployments"))
        if after.mean_success is not None:
            items.append((percent(after.mean_success), "episodes won, mean over deployments"))
    schedule = Schedule.of(run.description, len(run.agents))
    if schedule.rounds > 1:
        cost = schedule.steps * run.description.env.copies
        items.append((f"{cost:,}", f"transitions per deployment: M x {schedule.rounds} explorers"))
    if run.wall_seconds is not None:
        items.append((duration(run.wall_seconds), "wall time"))
    return html.figures(items) if items else ""


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
        ("wall time", duration(run.wall_seconds) if run.wall_seconds is not None else "unknown"),
    ]
    resumed = run.record.get("resumed")
    extended = run.record.get("extended")
    if isinstance(extended, list) and extended:
        items.append(("extended to deployments", ", ".join(map(str, extended))))
    if isinstance(processors := run.record.get("processors"), list) and processors:
        # Of another kind, the same description and seed come to other bits, and to other returns.
        items.append(("processor", ", then ".join(map(str, processors))))
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
