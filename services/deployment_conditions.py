"""What stands before each deployment: the floor that the one before must reach, and a person."""

import logging
from dataclasses import dataclass

from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.measuring import read_measured
from otc_dist.run import recommendation
from otc_dist.run.measured_returns import WITHOUT, Measured, TooFewError, alike
from otc_dist.system import records
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep

from . import person
from .process import Run

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Evaluated:
    """What of an evaluation is needed."""

    mean_return: float


class DeploymentConditions:
    """Decides whether deployment k takes place, by the run folder alone, whenever it is asked."""

    def __init__(self, run: Run) -> None:
        self._folder, self._settings = run.folder, run.description.deployment
        self._measured: dict[int, Measured] = {}

    def measured(self, k: int) -> Measured | None:
        """What deployment k measured, by its finished log; None: nothing, as agents explored or
        episodes are too few.

        Raises:
            TooFewError: nothing, and what the description asks for needs it.
        """
        if self._settings.exploration != "none":
            return None
        if k not in self._measured:
            try:
                _, self._measured[k] = read_measured(self._folder.deployment(k))
            except TooFewError:
                if self._settings.keep == "best" or self._settings.floor is not None:
                    raise
                return None
        return self._measured[k]

    def check_rewards(self, step: JointStep) -> None:
        """Refuse to keep the best where the agents would disagree on which it is.

        Raises:
            UserError: the step brought them different rewards.
        """
        if self._settings.keep == "best" and not alike(step.rewards):
            raise UserError(
                "deployment.keep = 'best' needs one reward for all agents, and they got different"
                f" ones in step {step.step}: set {WITHOUT}"
            )

    def below_floor(self, k: int) -> bool:
        """Whether deployment k does not take place, since the one before measured too little."""
        floor = self._settings.floor
        if k == 1 or floor is None or (found := self.measured(k - 1)) is None:
            return False
        if not recommendation.ends(floor, found):
            return False
        log.info(
            "deployment %d measured %.1f, below deployment.floor = %g: none follows",
            *(k - 1, found.mean, floor),
        )
        return True

    def needs_approval(self, k: int) -> bool:
        """Whether a person has yet to let deployment k begin."""
        begun = self._folder.deployment(k)
        paths = (begun, partial_path(begun), self._folder.approval(k))
        return self._settings.approve and not any(path.exists() for path in paths)

    def wait_for_approval(self, k: int) -> None:
        """Return once the approval of deployment k is there; meanwhile the run folder says for
        what this waits.

        Raises:
            FailureError, StoppedByFileError: as `person.wait_for`.
        """
        before = self.measured(k - 1) if k > 1 else None
        content = {
            "waits_for": f"a person's approval of deployment {k}, by policy {k - 1}",
            "deployment": k,
            "policy": k - 1,
            "measured": before and {"deployment": k - 1, **vars(before)},
            "greedy_return": self._greedy_return(k - 1),
        }
        log.info("deployment %d waits for a person: %s", k, self._folder.approval(k))
        person.wait_for(self._folder, self._folder.approval(k), content)

    def _greedy_return(self, k: int) -> float | None:
        try:
            return records.read_json(_Evaluated, self._folder.evaluation(k)).mean_return
        except (FileNotFoundError, UserError):
            return None
