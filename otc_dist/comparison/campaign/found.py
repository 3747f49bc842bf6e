"""All comparisons of a campaign that have scores, from a folder of raw scores."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from otc_dist.comparison import collected
from otc_dist.comparison.arms import REFERENCE
from otc_dist.comparison.collected import Collected
from otc_dist.comparison.scores import Run
from otc_dist.report.return_statistics import improvement
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class Found:
    """One comparison.

    Attributes:
        name: of its folder: the description's, the level of its data, and the part's.
        part: of the campaign's file.
    """

    name: str
    part: str
    scores: Collected

    @property
    def dataset(self) -> str:
        return self.scores.dataset

    @property
    def seeds(self) -> int:
        """How many the reference has: another arm may be a few behind."""
        return len(self.scores.runs[REFERENCE])

    def gain(self, value: float, first: float) -> float:
        """What a return has over pi_0's, in normalised score; where the task has no reference
        returns in percent of pi_0's, NaN where that is 0.
        """
        score, before = self.scores.normalise(value), self.scores.normalise(first)
        if score is None or before is None:
            return math.nan if (found := improvement(value, first)) is None else found
        return score - before

    def runs(self, arm: str) -> dict[int, Run]:
        """By seed."""
        return {run.seed: run for run in self.scores.runs.get(arm, ())}


def folders(root: Path) -> list[Path]:
    """Of all comparisons, with scores or yet without.

    Raises:
        UserError: there is none.
    """
    found = sorted(path.parent for path in root.glob("*/description.toml"))
    if not found:
        raise UserError(f"{root} is not the folder of a campaign: none in it is a comparison's")
    return found


def read(paths: Sequence[Path]) -> list[Found]:
    """Those that have scores. Raises UserError for a damaged file."""
    found = []
    for path in paths:
        if collected.has_scores(path):
            scores = collected.collect(path)
            before = f"{scores.name}-{scores.dataset.rpartition('/')[2]}-"
            found.append(Found(path.name, path.name.removeprefix(before), scores))
    return found
