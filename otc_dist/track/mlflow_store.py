"""MLflow: one of its runs, in a database of its own in the folder; no server, no network."""

import logging
import os
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"  # before the import: else it calls its makers

from mlflow.entities import Metric, Param, Run, ViewType
from mlflow.exceptions import MlflowException
from mlflow.tracking import MlflowClient
from sqlalchemy.exc import SQLAlchemyError

from otc_dist.terminal.errors import UserError
from otc_dist.track.trackers import About

_EXPERIMENT, _IDENTITY = "otc_dist", "otc_dist.run"
_MOST = 500  # metrics in one transaction; MLflow takes 1,000
_REFUSED = re.compile(r"[^\w\-. /]", re.ASCII)  # what may not be in the name of a metric
_LONGEST = 6000  # characters of a parameter


class MlflowStore:
    """The run of that identity, found again if it is there: what it holds is not added twice.

    MLflow's parameters cannot be changed: a run whose description has changed, as one that was
    extended, is written anew, and the one before goes to MLflow's bin.
    """

    def __init__(self, folder: Path, about: About) -> None:
        self._path, self._waiting = folder / "mlflow.db", list[Metric]()
        with self._one_line_errors():
            self._client = MlflowClient(f"sqlite:///{self._path}")
            experiment = self._client.get_experiment_by_name(_EXPERIMENT)
            place = (
                experiment.experiment_id
                if experiment
                else self._client.create_experiment(
                    _EXPERIMENT, artifact_location=(folder / "artifacts").as_uri()
                )
            )
            params = {name: str(x)[:_LONGEST] for name, x in about.settings.items()}
            run = self._find(place, about.identity)
            if run is not None and run.data.params not in ({}, params):
                self._client.delete_run(run.info.run_id)
                run = None
            if run is None:
                run = self._client.create_run(
                    place, run_name=about.name, tags={_IDENTITY: about.identity}
                )
            self._id: str = run.info.run_id
            if not run.data.params:
                every = [Param(name, value) for name, value in params.items()]
                self._client.log_batch(self._id, params=every)
            self._held = {
                (name, point.step)
                for name in run.data.metrics
                for point in self._client.get_metric_history(self._id, name)
            }

    def _find(self, experiment: str, identity: str) -> Run | None:
        quoted = identity.replace("'", "")
        found = self._client.search_runs(
            [experiment],
            f"tags.`{_IDENTITY}` = '{quoted}'",
            run_view_type=ViewType.ACTIVE_ONLY,
            max_results=1,
        )
        return found[0] if found else None

    def log(self, source: str, step: int, values: Mapping[str, float]) -> None:
        now = int(time.time() * 1000)
        for name, value in values.items():
            key = _REFUSED.sub("_", f"{source}/{name}")
            if (key, step) not in self._held:
                self._held.add((key, step))
                self._waiting.append(Metric(key, value, now, step))
        if len(self._waiting) >= _MOST:
            self.flush()

    def flush(self) -> None:
        with self._one_line_errors():
            while self._waiting:
                self._client.log_batch(self._id, metrics=self._waiting[:_MOST])
                del self._waiting[:_MOST]

    def close(self) -> None:
        self.flush()
        with self._one_line_errors():
            self._client.set_terminated(self._id)

    @contextmanager
    def _one_line_errors(self) -> Iterator[None]:
        """Turn what MLflow and its database raise into one line."""
        try:
            yield
        except (MlflowException, SQLAlchemyError) as error:
            reason = str(error).splitlines()[0]
            raise UserError(f"MLflow cannot write {self._path}: {reason}") from None


def open_tracker(folder: Path, about: About) -> MlflowStore:
    """As `trackers.open_tracker`."""
    for name in ("mlflow", "alembic"):  # that they make tables is nobody's concern
        logging.getLogger(name).setLevel(logging.WARNING)
    return MlflowStore(folder, about)
