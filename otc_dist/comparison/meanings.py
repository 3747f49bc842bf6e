"""What each arm is, in one line, for people who choose among them."""

from collections.abc import Iterator, Mapping

from otc_dist.comparison import arms
from otc_dist.comparison.arms import ANALYSES, KNOWN, ORACLE, PERFECT

MEANINGS: Mapping[str, str] = arms.MEANINGS | {
    PERFECT: "a ceiling: transitions as they would be with the others acting as now; compare only",
    ORACLE: "a ceiling: the tenth in which the others acted most as now; compare only",
}


def lines(*, analyses: bool) -> Iterator[str]:
    """A line for each arm, with those that no single run can take if `analyses`."""
    names = [*KNOWN, *(ANALYSES if analyses else ())]
    width = max(map(len, names))
    for name in names:
        yield f"  {name:{width}}  {MEANINGS[name]}"
