"""Whether a campaign reproduces what a publication claims: one rule for every figure and table."""

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isnan

import numpy as np

from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.comparison.campaign import pooled
from otc_dist.comparison.campaign.found import Found
from otc_dist.comparison.campaign.published import Figure, Published
from otc_dist.comparison.campaign.tables import WIDTH
from otc_dist.comparison.intervals import Difference
from otc_dist.comparison.judgement import returns

RULE = (
    "A claim that one arm is better than another is judged by their difference at the last"
    " deployment, seed by seed, the mean over the data sets: in normalised score, or in return"
    " where a task has none. Reproduced: both 95% intervals (bootstrap, Student's t) are above 0,"
    f" and the mean is above both of the null arm minus {REFERENCE}. Not reproduced: both are below"
    " 0; or, where the gains of both arms are published, both are below what these would be of our"
    " pi_0's return. Undecided: all else. A figure is reproduced if all of its claims are, and not"
    " reproduced if one of them is not. Where gains are published, data sets without do not count."
)
REPRODUCED, NOT_REPRODUCED, UNDECIDED = "reproduced", "not reproduced", "undecided"
NOT_RUN = "not run"


@dataclass(frozen=True)
class Pair:
    """One arm that is claimed to be better than another, over some data sets.

    Attributes:
        difference: None without a seed that all of them have.
        null: of the null arm from the reference, over the same data sets.
        printed: what the difference would be if each arm gained what is printed, of our pi_0's
            return; None where nothing is printed.
    """

    better: str
    than: str
    datasets: int
    difference: Difference | None
    null: Difference | None
    printed: float | None

    @property
    def verdict(self) -> str:
        one, null = self.difference, self.null
        if one is None or isnan(one.t_high):
            return UNDECIDED
        if one.excludes_zero:
            if one.mean < 0:
                return NOT_REPRODUCED
            if null is not None and one.mean > max(null.high, null.t_high):
                return REPRODUCED
        if self.printed is not None and max(one.high, one.t_high) < self.printed:
            return NOT_REPRODUCED
        return UNDECIDED

    def __str__(self) -> str:
        """What its difference is, and what is printed."""
        if self.difference is None:
            return f"{self.better} and {self.than} have no seed in common yet"
        by_t = f", by t {self.difference.student}" if self.difference.student != "-" else ""
        printed = "" if self.printed is None else f" (published: {self.printed:+,.1f})"
        return f"{self.better} minus {self.than} {self.difference}{by_t}{printed}"


@dataclass(frozen=True)
class Verdict:
    """What a campaign shows of a figure."""

    figure: Figure
    word: str
    shown: Sequence[Found]  # the comparisons that it was decided by
    why: str  # empty where nothing was run

    def __str__(self) -> str:
        """In one sentence."""
        return f"{self.word.capitalize()}{f': {self.why}' if self.why else ''}."


def judge(figure: Figure, found: Sequence[Found], published: Published | None) -> Verdict:
    """One figure."""
    shown = [
        one
        for one in found
        if one.part in figure.parts
        and (not figure.datasets or one.dataset in figure.datasets)
        and all(one.runs(arm) for arm in (*figure.arms, NULL))
    ]
    if not shown:
        return Verdict(figure, NOT_RUN, (), "")
    pairs = [
        _pair(better, than, shown, published) for better in figure.better for than in figure.than
    ]
    words = {pair.verdict for pair in pairs}
    word = UNDECIDED
    if NOT_REPRODUCED in words:
        word = NOT_REPRODUCED
    elif words == {REPRODUCED}:
        word = REPRODUCED
    nulls = dict.fromkeys(str(pair.null) for pair in pairs if pair.null is not None)
    sets = _counted([pair.datasets for pair in pairs], "data set")
    seeds = _counted([one.seeds for one in shown], "seed")
    why = (
        f"{'; '.join(map(str, pairs))}; by chance, the null arm minus {REFERENCE},"
        f" {', '.join(nulls)}; {sets}, {seeds}"
    )
    return Verdict(figure, word, shown, why)


def lines(verdicts: Sequence[Verdict]) -> Iterator[str]:
    """As text: the rule, and of each its claim and its sentence."""
    yield from textwrap.wrap(RULE, WIDTH)
    for one in verdicts:
        yield f"\n{one.figure.title}"
        yield f"  claim: {one.figure.claim}"
        yield f"  here: {one}"


def _pair(better: str, than: str, shown: Sequence[Found], published: Published | None) -> Pair:
    sizes = {
        one.name: size
        for one in shown
        if (size := _printed(better, than, one, published)) is not None
    }
    counted = [one for one in shown if one.name in sizes] if sizes else list(shown)
    return Pair(
        better,
        than,
        len(counted),
        pooled.difference(counted, better, than),
        pooled.difference(counted, NULL, REFERENCE),
        float(np.mean(list(sizes.values()))) if sizes else None,
    )


def _printed(better: str, than: str, one: Found, published: Published | None) -> float | None:
    """What is printed of the difference, in the unit of ours; None if it is not."""
    printed = {} if published is None else published.of(one.part, one.dataset)
    if better not in printed or than not in printed:
        return None
    percent = printed[better][0] - printed[than][0]
    firsts = [returns(run)[0] for run in one.runs(REFERENCE).values()]
    return float(np.mean([one.gain(x + percent / 100 * abs(x), x) for x in firsts]))


def _counted(counts: Sequence[int], what: str) -> str:
    """`3 seeds`, or `2 to 3 seeds` where they differ."""
    least, most = min(counts), max(counts)
    return f"{least if least == most else f'{least} to {most}'} {what}{'' if most == 1 else 's'}"
