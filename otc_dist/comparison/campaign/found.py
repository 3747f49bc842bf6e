"""All comparisons of a campaign that have scores, from a folder of raw scores."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from otc_dist.comparison import collected
from otc_dist.comparison.arms import REFERENCE
from otc_dist.comparison.collected import Collected
from otc_dist.comparison.scores import Run
from otc_dist.run.folder import RunFolder
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

    @property
    def scored(self) -> bool:
        """Whether the task has a normalised score."""
        return self.scores.normalise(0.0) is not None

    def gain(self, value: float, first: float) -> float:
        """What a return has over pi_0's, in normalised score, or in return where the task has none:
        in percent, a pi_0 that returns next to nothing would outweigh all others.
        """
        score, before = self.scores.normalise(value), self.scores.normalise(first)
        if score is None or before is None:
            return value - first
        return score - before

    def runs(self, arm: str) -> dict[int, Run]:
        """By seed."""
        return {run.seed: run for run in self.scores.runs.get(arm, ())}


def folders(root: Path) -> list[Path]:
    """Of all comparisons, with scores or yet without; runs have descriptions as well.

    Raises:
        UserError: there is none.
    """
    described = (path.parent for path in root.glob("*/description.toml"))
    found = sorted(path for path in described if not RunFolder(path).run_json.exists())
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
