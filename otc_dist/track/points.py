"""What a run has measured so far, as points for a tracker: each is given once.

All of it is read from the run's folder, so neither learners nor the env host know of trackers.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from otc_dist.deployment_log.measuring import read_measured
from otc_dist.description import Description
from otc_dist.report.run_data import read_evaluation, read_history
from otc_dist.run.folder import RunFolder
from otc_dist.run.measured_returns import TooFewError
from otc_dist.terminal.errors import UserError, os_error_line

TEAM = "team"  # the source of what all agents did together
GREEDY, MEASURED = "return/greedy", "return/measured"


@dataclass(frozen=True)
class Values:
    """Values of one place.

    Attributes:
        source: an agent's name, or `TEAM`.
        step: an agent's update in a phase, of tuning counted on over the deployments; k, for
            returns: of the greedy episodes of pi_k, and measured by deployment k.
        values: by `PHASE/METRIC`, or by `return/KIND`; what was not finite is NaN.
    """

    source: str
    step: int
    values: Mapping[str, float]


_Steps = Mapping[int, Mapping[str, float]]


class Points:
    """Reads a run's folder again and again, each time what has changed since.

    Attributes:
        problems: what was left out since it is damaged, a line each; by file.
    """

    def __init__(self, folder: RunFolder) -> None:
        self._folder, self._description = folder, Description.load(folder.description)
        self._seen: dict[Path, tuple[int, ...]] = {}  # what tells that a file has changed
        self._given: set[tuple[str, str, int]] = set()
        self.problems: dict[Path, str] = {}

    def new(self) -> Iterator[Values]:
        """What has not been given yet."""
        for path in sorted(self._folder.root.glob("agents/*/metrics.jsonl")):
            yield from self._changed(path.parent.name, path, _metrics)
        settings = self._description.deployment
        for k in range(settings.count + 1):
            yield from self._changed(TEAM, self._folder.evaluation(k), _evaluation)
        if settings.exploration == "none":  # else the policies are not what was measured
            for k in range(1, settings.total + 1):
                yield from self._changed(TEAM, self._folder.deployment(k), partial(_measured, k))

    def _changed(self, source: str, path: Path, read: Callable[[Path], _Steps]) -> Iterator[Values]:
        try:
            status = path.stat()
            mark = (status.st_ino, status.st_size, status.st_mtime_ns)
            if self._seen.get(path) == mark:
                return
            self._seen[path] = mark
            found = read(path)
        except FileNotFoundError:
            return
        except (UserError, ValueError) as error:
            self.problems[path] = str(error)
            return
        except OSError as error:
            self.problems[path] = os_error_line(error)
            return
        self.problems.pop(path, None)
        for step, values in sorted(found.items()):
            fresh = {
                name: value
                for name, value in values.items()
                if (source, name, step) not in self._given
            }
            if fresh:
                self._given.update((source, name, step) for name in fresh)
                yield Values(source, step, fresh)


def _metrics(path: Path) -> _Steps:
    """What a learner reported, by update."""
    found: dict[int, dict[str, float]] = {}
    for phase, curves in read_history(path).curves.items():
        for metric, points in curves.items():
            for update, value in points.items():
                found.setdefault(update, {})[f"{phase}/{metric}"] = value
    return found


def _evaluation(path: Path) -> _Steps:
    found = read_evaluation(path)
    values = {GREEDY: sum(found.returns) / len(found.returns)}
    if found.normalised_score is not None:
        values["return/normalised_score"] = found.normalised_score
    if found.successes:
        values["return/won"] = sum(found.successes) / len(found.successes)
    return {found.deployment: values}


def _measured(k: int, path: Path) -> _Steps:
    try:
        _, found = read_measured(path)
    except TooFewError:
        return {}
    return {k: {MEASURED: found.mean, "return/measured_error": found.error}}
