"""A summary as text: one table a measure, and the paired differences."""

from collections.abc import Iterator, Sequence
from math import isnan

from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.statistics import RESAMPLES, Spread, Summary, interval

TITLES = {
    "return": "return of the greedy team",
    "success": "episodes won (%)",
    "normalised score": "normalised score (0: random, 100: expert)",
    "improvement": "improvement over pi_0 (%)",
    "gain": "gain in normalised score over pi_0",
}
METHOD = (
    f"95% percentile intervals of the mean over seeds, {RESAMPLES:,} bootstrap resamples of seeds"
)


def measures(summary: Summary) -> list[str]:
    """The measures that the task has, in the order in which they are told."""
    return [measure for measure in TITLES if measure in summary.arms[0].measures]


def measure_rows(summary: Summary, measure: str) -> Iterator[list[str]]:
    """The header, a row for each of pi_0 .. pi_K, and the mean over deployments."""
    found = [arm.measures[measure] for arm in summary.arms]
    last = len(found[0].deployments) - 1
    yield ["policy", *(arm.name for arm in summary.arms)]
    for k in range(last + 1):
        yield [f"pi_{k}", *(spread(one.deployments[k]) for one in found)]
    yield [f"mean 1..{last}", *(spread(one.over_deployments) for one in found)]


def difference_rows(summary: Summary) -> Iterator[list[str]]:
    """The header and a row an arm; the null arm last, to be compared with."""
    last = len(summary.arms[0].measures["return"].deployments) - 1
    yield [f"minus {REFERENCE}", f"mean of deployments 1..{last}", "seeds", f"last ({last})"]
    arms = sorted(summary.arms, key=lambda arm: arm.name == NULL)
    for arm in arms:
        if arm.last and arm.over_deployments:
            differences = arm.over_deployments.seeds
            above = sum(value > 0 for value in differences)
            yield [
                arm.name,
                interval(arm.over_deployments),
                f"{above} of {len(differences)} above 0",
                interval(arm.last),
            ]


def spread(found: Spread) -> str:
    """`1,234.5 ± 67.8`."""
    if isnan(found.mean):
        return "-"
    deviation = "" if isnan(found.std) else f" ± {found.std:,.1f}"
    return f"{found.mean:,.1f}{deviation}"


def aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Lines: the first column to the left, the others to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        first, *others = (
            cell.rjust(width) if i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        yield "  ".join([first, *others]).rstrip()


def text(summary: Summary) -> Iterator[str]:
    """The whole summary, line by line."""
    for measure in measures(summary):
        yield f"\n{TITLES[measure]}, mean ± std over seeds"
        yield from aligned(list(measure_rows(summary, measure)))
    yield f"\npaired differences in return from {REFERENCE}; {METHOD}"
    yield from aligned(list(difference_rows(summary)))
    yield f"\n{summary.conclusion}"
