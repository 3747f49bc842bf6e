"""The table of returns on a run's page."""

import math
from collections.abc import Callable

from otc_dist.report import html
from otc_dist.report.results import Row, Tuned, rows, tuned
from otc_dist.report.run_data import RunData
from otc_dist.report.svg import MINUS, NOTHING, number

# Heading, an evaluation's cell, and that of the mean over deployments.
_Column = tuple[str, Callable[[Row], str], Callable[[Tuned], str]]

_COLUMNS: tuple[_Column, ...] = (
    (
        "deployment",
        lambda row: "offline" if row.deployment == 0 else str(row.deployment),
        lambda after: "mean over deployments",
    ),
    ("episodes", lambda row: str(row.returns.count), lambda after: ""),
    ("mean", lambda row: number(row.returns.mean), lambda after: number(after.mean_return)),
    ("std", lambda row: number(row.returns.std), lambda after: ""),
    (
        "range",
        lambda row: f"{number(row.returns.minimum)} … {number(row.returns.maximum)}",
        lambda after: "",
    ),
    ("length", lambda row: _plain(row.length), lambda after: ""),
)
_WON: _Column = (
    "won",
    lambda row: percent(row.success),
    lambda after: percent(after.mean_success),
)
_SCORE: tuple[_Column, ...] = (
    ("normalised", lambda row: _plain(row.score), lambda after: _plain(after.mean_score)),
    ("gained", lambda row: signed(row.gain), lambda after: signed(after.gain)),
)
_IMPROVEMENT: _Column = (
    "improvement",
    lambda row: signed(row.improvement, " %"),
    lambda after: signed(after.improvement, " %"),
)


def returns_table(run: RunData) -> str:
    """One row an evaluation and their mean; columns that the task has nothing for are left out."""
    table, after = rows(run), tuned(run)
    if not table:
        return ""
    won = any(row.success is not None for row in table)
    scored = any(row.score is not None for row in table)
    columns = [*_COLUMNS, *[_WON] * won, *_SCORE * scored, _IMPROVEMENT]
    body = [[cell(row) for _, cell, _ in columns] for row in table]
    if after:
        body.append([mean(after) for *_, mean in columns])
    notes = [
        *["Won: share of the episodes."] * won,
        *[
            "Normalised: 0 is the random policy, 100 the expert. Gained: normalised score beyond"
            " the offline one."
        ]
        * scored,
        "Improvement: 100 (R_k - R_0) / |R_0|, which explodes where the offline return is near 0.",
    ]
    return html.section(
        "Returns",
        html.table([name for name, *_ in columns], body, sums=1 if after else 0),
        html.note(" ".join(notes)),
    )


def percent(value: float | None) -> str:
    """`12.5 %`."""
    return NOTHING if value is None else f"{value:.1f} %"


def signed(value: float | None, unit: str = "") -> str:
    """With its sign: `+1,234.5`."""
    if value is None or not math.isfinite(value):
        return NOTHING
    return f"{value:+,.1f}{unit}".replace("-", MINUS)


def _plain(value: float | None) -> str:
    return NOTHING if value is None else number(value)
