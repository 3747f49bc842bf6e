"""What stands before each deployment: the floor that the one before must reach, and a person."""

import json
import logging
import os
import time
from contextlib import suppress
from dataclasses import dataclass

from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.measuring import read_measured
from otc_dist.run import recommendation
from otc_dist.run.measured_returns import Measured, TooFewError, alike
from otc_dist.system import durable, records
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep

from .process import FailureError, Run

log = logging.getLogger(__name__)

_LOOK = 0.1  # seconds between two looks for the person's file


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
                f" ones in step {step.step}: use deployment.keep = 'last'"
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
            FailureError: it cannot be said.
        """
        approval, waiting = self._folder.approval(k), self._folder.waiting
        before = self.measured(k - 1) if k > 1 else None
        content = {
            "waits_for": f"a person's approval of deployment {k}, by policy {k - 1}",
            "deployment": k,
            "policy": k - 1,
            "approve_by": str(approval.relative_to(self._folder.root)),
            "measured": before and {"deployment": k - 1, **vars(before)},
            "greedy_return": self._greedy_return(k - 1),
        }
        try:  # a signal may end this at any moment: nobody waits any more then
            durable.write(waiting, (json.dumps(content, indent=1) + "\n").encode())
            log.info("deployment %d waits for a person: %s", k, approval)
            while not approval.exists():
                time.sleep(_LOOK)
        except OSError as error:
            reason = os.strerror(error.errno) if error.errno else str(error)
            raise FailureError(f"cannot write {waiting}: {reason}") from None
        finally:
            with suppress(OSError):
                waiting.unlink()

    def _greedy_return(self, k: int) -> float | None:
        try:
            return records.read_json(_Evaluated, self._folder.evaluation(k)).mean_return
        except (FileNotFoundError, UserError):
            return None
