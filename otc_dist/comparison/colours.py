"""Which colour stands for which arm, wherever it is shown."""

from collections.abc import Iterable, Mapping

from otc_dist.comparison.arms import NULL, REFERENCE
from otc_dist.report.svg import GREY


def colours(arms: Iterable[str]) -> Mapping[str, int]:
    """Arm -> colour of a series; with what all are compared, and what chance does, are grey."""
    found: dict[str, int] = {}
    for arm in arms:
        taken = sum(colour != GREY for colour in found.values())
        found[arm] = GREY if arm in (REFERENCE, NULL) else taken
    return found
