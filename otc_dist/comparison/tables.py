"""A summary as text: what the runs are judged by, their differences, and one table a measure."""

from collections.abc import Iterator, Mapping, Sequence
from math import isnan

from otc_dist.comparison.arms import NULL, PERFECT, REFERENCE
from otc_dist.comparison.intervals import RESAMPLES
from otc_dist.comparison.judgement import MEAN, RECOMMENDED, WORST
from otc_dist.comparison.score_statistics import Arm, Judged, Summary
from otc_dist.comparison.scores import Run
from otc_dist.report.return_statistics import Spread
from otc_dist.terminal.printable import aligned

TITLES = {
    "return": "return of the greedy team",
    "success": "episodes won (%)",
    "normalised score": "normalised score (0: random, 100: expert)",
    "improvement": "change from pi_0 (%)",
    "gain": "gain in normalised score over pi_0",
}
JUDGED_TITLES = {
    RECOMMENDED: "recommended policy: the one whose deployment brought the best rewards",
    MEAN: "mean over the deployments, of pi_1 .. pi_K",
    WORST: "worst deployed policy, of pi_0 .. pi_{K-1}",
}
SHORT_TITLES = {
    RECOMMENDED: "Recommended policy",
    MEAN: "Mean over the deployments",
    WORST: "Worst deployed policy",
}
METHOD = (
    "over seeds: mean [95% percentile interval of the mean,"
    f" {RESAMPLES:,} bootstrap resamples], by Student's t, and the interquartile mean (IQM)"
)
SHARE = (
    f"of the way: from {REFERENCE} to {PERFECT}, where both intervals of {PERFECT} minus"
    f" {REFERENCE} exclude 0"
)
GAIN_TITLES = {
    RECOMMENDED: "gain of the recommended policy over pi_0; the best of several deployments has"
    " one with any sampling",
    MEAN: "gain of the mean over the deployments over pi_0: of tuning, without keeping the best",
}
NOTHING = "-"


def measures(summary: Summary) -> list[str]:
    """The measures that the task has, in the order in which they are reported."""
    return [measure for measure in TITLES if measure in summary.arms[0].measures]


def judged(summary: Summary) -> list[str]:
    """What the runs are judged by, in the order in which it is reported."""
    return [name for name in JUDGED_TITLES if any(name in arm.judged for arm in summary.arms)]


def label(arm: Arm) -> str:
    """An arm's name, with a mark if it began from offline policies of its own."""
    return f"{arm.name} *own pi_0*" if arm.own_pi_0 else arm.name


def measure_rows(summary: Summary, measure: str) -> Iterator[list[str]]:
    """The header, how many seeds, a row for each of pi_0 .. pi_K, and the mean of pi_1 .. pi_K."""
    arms = [arm for arm in summary.arms if measure in arm.measures]
    found = [arm.measures[measure] for arm in arms]
    last = len(found[0].deployments) - 1
    yield ["policy", *map(label, arms)]
    yield ["seeds", *(str(len(arm.seeds)) for arm in arms)]
    for k in range(last + 1):
        yield [f"pi_{k}", *(spread(one.deployments[k]) for one in found)]
    yield [f"mean 1..{last}", *(spread(one.over_deployments) for one in found)]


def gains(summary: Summary) -> list[str]:
    """What is held against pi_0, in the order in which it is reported."""
    return [name for name in GAIN_TITLES if any(name in arm.gains for arm in summary.arms)]


def gain_rows(summary: Summary, measure: str) -> Iterator[list[str]]:
    """The header, and what each arm returns by that measure and has over pi_0."""
    yield [measure, "return", "IQM", "minus pi_0", "by t", "above pi_0", "median gain"]
    for arm in null_last(summary):
        if measure in arm.gains:
            found, gained = arm.judged[measure].spread, arm.gains[measure].difference
            median = arm.gains[measure].median
            yield [
                label(arm),
                spread(found),
                f"{found.iqm:,.1f}",
                str(gained),
                gained.student,
                f"{gained.above} of {len(gained.seeds)} seeds",
                NOTHING if isnan(median) else f"{median:+,.0f}%",
            ]


def difference_rows(summary: Summary, measure: str) -> Iterator[list[str]]:
    """The header and a row an arm; the null arm last, to be compared with."""
    arms = [(arm, arm.judged[measure]) for arm in null_last(summary) if measure in arm.judged]
    shares = any(one.share is not None for _, one in arms)
    head = [measure, "mean ± std", "IQM", f"minus {REFERENCE}", "by t", "its IQM", "above 0"]
    yield [*head, "of the way"] if shares else head
    for arm, one in arms:
        cells = [label(arm), spread(one.spread), f"{one.spread.iqm:,.1f}", *_difference(one)]
        yield [*cells, _share(one)] if shares else cells


def _difference(one: Judged) -> list[str]:
    found = one.difference
    if found is None:
        return [NOTHING] * 4
    above = f"{found.above} of {len(found.seeds)} seeds"
    return [str(found), found.student, f"{found.iqm:+,.1f}", above]


def _share(one: Judged) -> str:
    return NOTHING if one.share is None else f"{100 * one.share:.0f}%"


def null_last(summary: Summary) -> list[Arm]:
    """All arms, at the end the one that differs by chance alone."""
    return sorted(summary.arms, key=lambda arm: arm.name == NULL)


def spread(found: Spread) -> str:
    """`1,234.5 ± 67.8`, or nothing."""
    return NOTHING if isnan(found.mean) else str(found)


def processors(runs: Mapping[str, Sequence[Run]]) -> str:
    """Those that the runs were made on: on another one the same run differs by chance."""
    found = {run.processor for of_arm in runs.values() for run in of_arm}
    return ", ".join(sorted(found))


def text(summary: Summary) -> Iterator[str]:
    """The whole summary, line by line."""
    for measure in measures(summary):
        yield f"\n{TITLES[measure]}, mean ± std over seeds"
        yield from aligned(measure_rows(summary, measure), str.rjust)
    yield f"\n{METHOD};\npaired differences are over the seeds that both sides have"
    for name in gains(summary):
        yield f"\n{GAIN_TITLES[name]}"
        yield from aligned(gain_rows(summary, name), str.rjust)
    for name in judged(summary):
        yield f"\n{JUDGED_TITLES[name]}"
        yield from aligned(difference_rows(summary, name), str.rjust)
    if any(one.share is not None for arm in summary.arms for one in arm.judged.values()):
        yield SHARE
    yield f"\n{summary.conclusion}"
