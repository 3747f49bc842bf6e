"""A campaign's tables: data sets in rows, arms in columns."""

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from otc_dist.comparison import tables
from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.campaign import pooled
from otc_dist.comparison.campaign.found import Found
from otc_dist.comparison.campaign.pooled import Judge, last
from otc_dist.comparison.campaign.published import Published
from otc_dist.comparison.judgement import over_deployments, recommended, returns
from otc_dist.report.return_statistics import Spread, improvement
from otc_dist.terminal.amounts import plus_minus
from otc_dist.terminal.printable import aligned

Rows = list[list[str]]
NOTE = (
    "Last: pi_K, after all deployments; recommended: the policy whose deployment brought the best"
    " rewards. Gains are over pi_0, in normalised score, or in return where a task has none. Mean ±"
    " std over seeds; [95% interval by bootstrap], of all data sets together with seeds resampled"
    " within each."
)
WIDTH = 100  # of the note's lines
CHANGE = "change from pi_0, last (%)"
JUDGED: dict[str, Judge] = {
    "last": last,
    "mean over the deployments": over_deployments,
    "recommended": recommended,
}
MINUS = f"last, minus {REFERENCE}, seed by seed"
POOLED = (
    "all data sets together: interquartile means (IQM) of the gains of all runs; minus"
    f" {REFERENCE}, seed by seed; the probability that a run ends better than one of {REFERENCE}"
)


def parts(found: Sequence[Found]) -> dict[str, list[Found]]:
    """Part -> its comparisons, in order of their data sets."""
    by_part: dict[str, list[Found]] = {}
    for one in sorted(found, key=lambda one: (one.part, one.dataset)):
        by_part.setdefault(one.part, []).append(one)
    return by_part


def beside_published(found: Sequence[Found], published: Published) -> Rows:
    """The published table with ours above each of its rows, in its order, and two lines of heads.

    Its arms and the null arm, a part after the other; of a part of which nothing is published the
    reference, and what is recommended of it. Parts on other data sets alone are left out; of none
    there is no table.
    """
    printed_of = {*published.datasets}
    by_part = {
        part: several
        for part, several in parts(found).items()
        if any(one.dataset in printed_of for one in several)
    }
    if not by_part:
        return []
    shown = [one for several in by_part.values() for one in several]
    columns: list[tuple[str, str, Judge]] = []
    for part, several in by_part.items():
        printed = published.arms(part)
        mine = [(part, arm, last) for arm in _arms(several) if arm in printed]
        default = [(part, REFERENCE, last), (part, REFERENCE, recommended)]
        columns += [*(mine or default), (part, NULL, last)]
    known = {(one.part, one.dataset): one for one in shown}
    datasets = dict.fromkeys([*published.datasets, *sorted(one.dataset for one in shown)])
    rows = [
        ["", *(part for part, _, _ in columns)],
        [CHANGE, *(arm if judge is last else "recommended" for _, arm, judge in columns)],
    ]
    for dataset in datasets:
        of_row = [(known.get((part, dataset)), arm, judge) for part, arm, judge in columns]
        if any(one for one, _, _ in of_row):
            cells = [
                _change(judge, one, arm) if one else tables.NOTHING for one, arm, judge in of_row
            ]
            rows.append([dataset, *cells])
            rows.append(
                [
                    "published",
                    *(_printed(published, dataset, part, arm) for part, arm, _ in columns),
                ]
            )
    return rows


def of_part(several: Sequence[Found]) -> Iterator[tuple[str, Rows]]:
    """Title and rows, the first of them the heads, of every table of a part."""
    arms = _arms(several)
    head = ["", "seeds", *arms]
    yield CHANGE, [head, *_each(several, arms, partial(_change, last))]
    for name, judge in JUDGED.items():
        yield f"gain, {name}", [head, *_each(several, arms, partial(_gain, judge))]
    yield f"gain, {MINUS}", [head, *_each(several, arms, _minus)]
    yield POOLED, list(_together(several, arms))


def text(found: Sequence[Found], published: Published | None) -> Iterator[str]:
    """All of them, line by line."""
    if published is not None and (beside := beside_published(found, published)):
        yield f"published: {published.source}"
        yield from aligned(beside, str.rjust)
        yield ""
    yield from textwrap.wrap(NOTE, WIDTH)
    for part, several in parts(found).items():
        for title, rows in of_part(several):
            yield f"\n{part}: {title}"
            yield from aligned(rows, str.rjust)


def _arms(several: Sequence[Found]) -> list[str]:
    """Of all comparisons, the null arm last."""
    names = dict.fromkeys(name for one in several for name in one.scores.runs)
    return sorted(names, key=lambda name: name == NULL)


def _printed(published: Published, dataset: str, part: str, arm: str) -> str:
    found = published.of(part, dataset).get(arm)
    return "" if found is None else plus_minus(*found)


def _each(
    several: Sequence[Found], arms: Sequence[str], cell: Callable[[Found, str], str]
) -> Iterator[list[str]]:
    for one in several:
        yield [one.dataset, str(one.seeds), *(cell(one, arm) for arm in arms)]


def _change(judge: Judge, one: Found, arm: str) -> str:
    values = []
    for run in one.runs(arm).values():
        value = judge(run)
        change = None if value is None else improvement(value, returns(run)[0])
        values.append(math.nan if change is None else change)
    return _spread(values)


def _gain(judge: Judge, one: Found, arm: str) -> str:
    return _spread(list(pooled.gains(one, arm, judge).values()))


def _spread(values: Sequence[float]) -> str:
    return tables.spread(Spread.of(values)) if values else tables.NOTHING


def _minus(one: Found, arm: str) -> str:
    found = None if arm == REFERENCE else pooled.difference([one], arm, REFERENCE)
    return tables.NOTHING if found is None else str(found)


def _together(several: Sequence[Found], arms: Sequence[str]) -> Iterator[list[str]]:
    """An arm a row."""
    sets = "1 data set" if len(several) == 1 else f"{len(several)} data sets"
    yield [sets, *JUDGED, f"minus {REFERENCE}", "by t", f"better than {REFERENCE}"]
    for arm in arms:
        found = [pooled.iqm(several, arm, judge) for judge in JUDGED.values()]
        minus = None if arm == REFERENCE else pooled.difference(several, arm, REFERENCE)
        better = None if arm == REFERENCE else pooled.improving(several, arm)
        yield [
            arm,
            *(tables.NOTHING if one is None else str(one) for one in found),
            *((tables.NOTHING,) * 2 if minus is None else (str(minus), minus.student)),
            tables.NOTHING if better is None else better.percent,
        ]
