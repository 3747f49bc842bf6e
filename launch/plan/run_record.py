"""run.json and the lock: what a run is, where it stands, and who may go on with it."""

import json
import os
import platform
import secrets
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, Self

from otc_dist import __version__, names
from otc_dist.description import Description
from otc_dist.names import Name
from otc_dist.run.folder import RunFolder
from otc_dist.system import durable, locks, records
from otc_dist.system.processor import kind
from otc_dist.system.versions import PACKAGES, of_packages
from otc_dist.terminal.errors import UserError

from . import artifacts
from .placement import Placement

# "reporting": all is done but the report. "finished" is the last thing that is written.
State = Literal["running", "stopped", "failed", "reporting", "finished"]
LOCK = ".lock"  # held by the launcher that is at work, the first file of a run folder


@dataclass(frozen=True)
class RunRecord:
    """The contents of run.json."""

    run: Name  # the run's name on the bus
    description: str  # digest of description.toml
    command: list[str]
    versions: dict[str, str]
    started: str  # UTC, ISO 8601
    state: State = "running"
    finished: str | None = None  # all but the report; UTC, ISO 8601
    quick: bool = False
    place: Placement = field(default_factory=Placement)  # which part of the run this folder holds
    resumed: tuple[str, ...] = ()  # when --resume went on with it
    extended: tuple[int, ...] = ()  # to how many deployments --deployments extended it
    processors: tuple[str, ...] = ()  # the kinds that it has run on, in order; see `processor.kind`
    libraries: tuple[str, ...] = ()  # paths of those that computed
    inputs: Mapping[str, str] = field(default_factory=dict)  # see `otc_dist.datasets.inputs`
    origin: str | None = None  # the run whose policies pi_0 it began with; None: it trained them

    def write(self, folder: RunFolder) -> None:
        """Replace run.json in one step."""
        durable.write(folder.run_json, (json.dumps(asdict(self), indent=2) + "\n").encode())

    def moved_to(self, state: State, folder: RunFolder) -> Self:
        """The record with another state, written."""
        done = state in ("reporting", "finished")
        record = replace(self, state=state, finished=(self.finished or _now()) if done else None)
        record.write(folder)
        return record

    @classmethod
    def read(cls, folder: RunFolder) -> Self:
        """Raises UserError if the folder is no run's, or its run.json is damaged."""
        try:
            return records.read_json(cls, folder.run_json)
        except FileNotFoundError:
            raise folder.lacks(folder.run_json) from None


def versions() -> dict[str, str]:
    """Package -> version of everything that a run's bits depend on: it goes on only with these."""
    return {
        "python": platform.python_version(),
        "otc-dist": __version__,
        **dict.fromkeys(PACKAGES, "not installed"),
        **of_packages(*PACKAGES),
    }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def create(
    folder: RunFolder,
    description: Description,
    quick: bool,
    placement: Placement,
    origin: Path | None = None,
) -> RunRecord:
    """Write a new run's description.toml and run.json.

    Args:
        origin: the folder of the run whose policies pi_0 it begins with.
    """
    started = _now()
    record = RunRecord(
        run=_own_name(folder) if placement.role == "all" else shared_name(description),
        description=description.digest(),
        command=["python", "-m", "otc_dist.launch", *sys.argv[1:]],
        versions=versions(),
        started=started,
        quick=quick,
        place=placement,
        processors=(kind(),),
        origin=str(origin) if origin else None,
    )
    durable.write(folder.description, description.to_toml().encode())
    record.write(folder)
    return record


def shared_name(description: Description) -> str:
    """The name on the bus of a run on several hosts, which all know nothing but its description."""
    return names.from_text(f"{description.name}-seed{description.seed}")


def _own_name(folder: RunFolder) -> str:
    """The name of a run on one machine: unique, should two of one name meet on a router."""
    return f"{names.from_text(folder.root.name)[: names.LONGEST - 7]}-{secrets.token_hex(3)}"


def _begun(folder: RunFolder) -> tuple[RunRecord, Description]:
    """The record and description of a run. Raises UserError if that is not what it began with."""
    record = RunRecord.read(folder)
    description = Description.load(folder.description).trusted()
    if description.digest() != record.description:
        raise changed(folder)
    return record, description


def reopen(folder: RunFolder) -> tuple[RunRecord, Description]:
    """The record and description of a run to go on with, marked as running again.

    A finished one goes on if something that it made is missing or damaged: that is made again. The
    parts of one on several hosts always do, since another part may need them for that.

    Raises:
        UserError: no run folder; finished already; another description or other versions now.
    """
    record, description = _begun(folder)
    state: State = "running"
    if record.state in ("reporting", "finished"):
        state = _after_the_end(folder, description, record)
    check_versions(record, folder)
    record = _on_this_processor(record, folder)
    return replace(record, resumed=(*record.resumed, _now())).moved_to(state, folder), description


def _on_this_processor(record: RunRecord, folder: RunFolder) -> RunRecord:
    """The record with this kind of processor; if it is another one, a line says what that means."""
    here, before = kind(), record.processors[-1:]
    if before == (here,):
        return record
    if before:
        print(
            f"{folder.root} ran on {before[0]}, and this is {here}: products are rounded"
            " differently, so it continues from its checkpoints as they are, but not to the bytes"
            " that it would have reached there",
            flush=True,
        )
    return replace(record, processors=(*record.processors, here))


def _after_the_end(folder: RunFolder, description: Description, record: RunRecord) -> State:
    """From where a run goes on that had come to its end. Raises UserError if all of it is there."""
    if (lost := artifacts.lost_work(folder, description, record.place)) is not None:
        print(f"{lost}: it is made again", flush=True)
        return "running"
    if record.state == "reporting" or artifacts.lost_report(folder, record.place):
        return "reporting"
    if record.place.role != "all":
        print("this part is finished; it takes part again for those that are not", flush=True)
        return "running"
    raise UserError(f"{folder.root} is finished; see {folder.report}; --deployments N extends it")


def changed(folder: RunFolder) -> UserError:
    """That the description is another one than when the run began."""
    return UserError(
        f"{folder.description} has changed since the run began; restore it, or start a new run"
    )


def check_versions(record: RunRecord, folder: RunFolder) -> None:
    """Refuse to go on with other versions of what a run's bits depend on. Raises UserError."""
    now = versions()
    for package, before in record.versions.items():
        if now.get(package) != before:
            raise UserError(
                f"{folder.root} was begun with {package} {before}, and this is"
                f" {now.get(package, 'unknown')}: the result would be neither's;"
                f" install {before} or start a new run"
            )


def check_part(folder: RunFolder, description: Description, placement: Placement) -> None:
    """See that a folder is of this part of a run on several hosts, and can be gone on with.

    Raises:
        UserError: it is of another description or of another part, or other versions now.
    """
    before = RunRecord.read(folder)
    part = (before.description, before.place.role, before.place.agent)
    if part != (description.digest(), placement.role, placement.agent):
        raise UserError(f"{folder.root} is of another run, or of another part; use another --out")
    record, _ = _begun(folder)
    check_versions(record, folder)


def rejoin(folder: RunFolder, description: Description, placement: Placement) -> RunRecord:
    """The record of this part of a run to go on with, whose endpoints may have changed.

    Raises:
        UserError: as `check_part` and `reopen`.
    """
    check_part(folder, description, placement)
    record, _ = reopen(folder)
    return replace(record, place=placement).moved_to(record.state, folder)


@contextmanager
def locked(folder: RunFolder) -> Iterator[None]:
    """Hold the run folder against other launchers; the kernel lets go if this one dies.

    Raises:
        UserError: another launcher holds it.
    """
    path = folder.root / LOCK
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        if not locks.take(descriptor, path):
            raise UserError(f"another launcher is at work in {folder.root}")
        yield
    finally:
        os.close(descriptor)


def launched(folder: RunFolder) -> bool | None:
    """Whether a launcher is at work there, without writing anything; None: no lock says."""
    try:
        descriptor = os.open(folder.root / LOCK, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    except OSError:  # of somebody else, who lets us read the rest
        return None
    try:
        return locks.held(descriptor)
    finally:
        os.close(descriptor)
