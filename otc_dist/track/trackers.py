"""The trackers that a run can be written to. A new one: one more line, and its module."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from otc_dist.system import extras


class Tracker(Protocol):
    """A run in somebody else's form. Each point is in it once, also of a run written before."""

    def log(self, source: str, step: int, values: Mapping[str, float]) -> None:
        """Add points; whoever wrote the run before may have added them already.

        Raises:
            OSError, UserError: it cannot be written.
        """
        ...

    def flush(self) -> None:
        """Let readers see all of it. Raises as `log`."""
        ...

    def close(self) -> None:
        """Write what comes last. Raises as `log`."""
        ...


@dataclass(frozen=True)
class About:
    """Whose points they are.

    Attributes:
        name: of the run, for people.
        identity: tells it from all other runs.
        settings: of its description, as `section.key`.
        results: names of the values by which runs are compared.
    """

    name: str
    identity: str
    settings: Mapping[str, str | int | float | bool]
    results: tuple[str, ...]


@dataclass(frozen=True)
class Kind:
    """A tracker.

    Attributes:
        module: has `open_tracker(folder, about)`; it and its packages are imported when needed.
        packages: names of what is imported there.
        look: the command that shows what is written into a folder.
    """

    module: str
    packages: tuple[str, ...]
    look: str


TRACKERS = {
    "mlflow": Kind(
        "otc_dist.track.mlflow_store",
        ("mlflow", "sqlalchemy", "alembic"),
        "mlflow ui --backend-store-uri sqlite:///{folder}/mlflow.db",
    ),
    "tensorboard": Kind(
        "otc_dist.track.event_files", ("tensorboard",), "tensorboard --logdir {folder}"
    ),
}


def check_installed(name: str) -> None:
    """Raises UserError, with what to install, if a tracker's packages are not there."""
    extras.check(f"tracking by {name}", TRACKERS[name].packages, name)


def open_tracker(name: str, folder: Path, about: About) -> Tracker:
    """Open a tracker that writes into `folder`, which is there.

    Raises:
        OSError, UserError: it cannot be written.
    """
    return cast(Tracker, import_module(TRACKERS[name].module).open_tracker(folder, about))
