"""What a learner tells of itself: by its statuses, and in metrics.jsonl."""

from typing import TYPE_CHECKING

from otc_dist.bus.keys import Keys
from otc_dist.bus.messages import Status
from otc_dist.bus.session import Session
from otc_dist.bus.status import Heartbeat
from otc_dist.bus.wire import Rejections
from otc_dist.description.distances import SAMPLER_METRICS
from otc_dist.run.folder import RunFolder

from .metrics import MetricsFile

if TYPE_CHECKING:
    from otc_dist.learner.trainer import Progress


class LearnerReport:
    """Where one agent's learner stands."""

    def __init__(
        self, session: Session, keys: Keys, folder: RunFolder, name: str, rejections: Rejections
    ) -> None:
        self._name, self._status = name, Status(name)
        self._metrics = MetricsFile(folder.metrics(name))
        self._sampler_metrics: dict[str, float] = {}  # by the sampler, of the newest deployment
        self.heartbeat = Heartbeat(session, keys, name, rejections, lambda: self._status)

    def enter(self, phase: str, deployment: int, done: int = 0, total: int = 0) -> None:
        """Another phase, or `done` of `total` in it: in the next status, whenever that is due."""
        self._status = Status(
            self._name, phase, deployment, done, total, metrics=self._sampler_metrics
        )

    def trained(self, progress: "Progress") -> None:
        """Training is so far: a line of metrics.jsonl. Its beginning and end are told at once."""
        self._metrics.write(progress)
        sampler_metrics = {
            name: progress.metrics[name] for name in SAMPLER_METRICS if name in progress.metrics
        }
        if progress.phase == "tuning" and sampler_metrics:
            self._sampler_metrics = sampler_metrics
        before = self._status
        self._status = Status(
            self._name,
            progress.phase,
            progress.deployment,
            progress.update,
            progress.updates,
            metrics={**self._sampler_metrics, **progress.metrics},
        )
        if before.phase != progress.phase or progress.update == progress.updates:
            self.heartbeat.publish()
