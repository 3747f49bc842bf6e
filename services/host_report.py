"""What the env host tells of itself: to launcher and learners by its statuses, and by counts."""

import logging

from otc_dist.bus.keys import HOST, Keys
from otc_dist.bus.lockstep import HostLockstep
from otc_dist.bus.messages import Status
from otc_dist.bus.session import Session
from otc_dist.bus.status import Heartbeat
from otc_dist.bus.wire import Rejections
from otc_dist.envs.rollout import Rollout
from otc_dist.run.measured_returns import Measured
from otc_dist.terminal.amounts import plus_minus

from .exposition import Counts

log = logging.getLogger(__name__)


class HostReport:
    """Where the env host stands.

    Attributes:
        rollout: of the phase under way; one that goes over a log again shows its progress, too.
        metrics: of the phase under way, named numbers.
    """

    def __init__(
        self,
        session: Session,
        keys: Keys,
        lockstep: HostLockstep,
        rejections: Rejections,
        epoch: int,
    ) -> None:
        self._lockstep, self._rejections, self._epoch = lockstep, rejections, epoch
        self._phase, self._deployment, self._total = "starting", 0, 0
        self.rollout: Rollout | None = None
        self.metrics: dict[str, float] = {}
        self._returns: dict[str, float] = {}  # the newest of each kind
        self.heartbeat = Heartbeat(session, keys, HOST, rejections, self._status)

    def enter(self, phase: str, k: int, total: int) -> None:
        """Another phase begins, of `total` lock-steps, with nothing to tell yet."""
        self.rollout, self.metrics = None, {}
        self._phase, self._deployment, self._total = phase, k, total
        self.heartbeat.publish()

    def within(self, phase: str) -> None:
        """Another phase of the same steps: what there is to tell stays."""
        self._phase = phase
        self.heartbeat.publish()

    def evaluated(self, k: int, mean: float, success: float | None) -> None:
        """Greedy episodes of pi_k have returned so much; `success`: percent of them won."""
        self.metrics, self._returns["greedy"] = {"return": mean}, mean
        if success is not None:
            self.metrics["success"] = success
        self.heartbeat.publish()
        means = " ".join(f"{name} {value:.2f}" for name, value in self.metrics.items())
        log.info("evaluation of policy %d, means: %s", k, means)

    def deployed(self, k: int, found: Measured | None) -> None:
        """Deployment k is over, and has measured that, if anything."""
        if found:
            self.metrics |= {"measured": found.mean, "error": found.error}
            self._returns["measured"] = found.mean
            log.info("deployment %d measured %s", k, plus_minus(found.mean, found.error))
        self.heartbeat.publish()

    def _status(self) -> Status:
        rollout = self.rollout
        return Status(
            HOST,
            self._phase,
            self._deployment,
            rollout.step if rollout else 0,
            self._total,
            metrics={"epoch": float(self._epoch), **self.metrics},
            awaits=self._lockstep.awaited,
        )

    def counts(self) -> Counts:
        """What is counted and measured, from any thread."""
        lockstep = self._lockstep
        returns, rejected = dict(self._returns), self._rejections.by_reason()
        return Counts(lockstep.answered, lockstep.resent, rejected, returns)
