"""Writing a data set: all of it or nothing, by one process at a time."""

import errno
import logging
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import otc_dist
from otc_dist.datasets.agent_files import FORMAT_VERSION, Header, encode
from otc_dist.datasets.card import (
    FILE_NAME,
    AgentFile,
    DatasetCard,
    Summary,
    normalised_scores,
)
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.names import DatasetName
from otc_dist.envs import registry
from otc_dist.system import durable, locks
from otc_dist.system.kernel import thread_times
from otc_dist.system.versions import of_packages
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float64

_LOCK = ".lock"
_STAGING = ".making-"  # a set that is being written; never read
_LOOK = 0.2  # seconds between two attempts to lock what another process is making
_LOG_EVERY = 30.0  # seconds between two lines that say so
_PATIENCE = 60.0  # seconds that the other may do nothing at all

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Provenance:
    """How a data set came about; see `DatasetCard` for the fields."""

    origin: str
    recipe: dict[str, str]
    versions: dict[str, str]
    returns: Float64  # team returns of the complete episodes
    incomplete_episodes: int
    notes: tuple[str, ...] = ()


def versions(*packages: str) -> dict[str, str]:
    """Versions of ourselves, NumPy and `packages`, for cards and headers."""
    return {
        "otc_dist": otc_dist.__version__,
        **of_packages("numpy", *packages),
    }


@contextmanager
def locked(name: DatasetName) -> Iterator[None]:
    """Be the only process that writes sets of that name; a process that ends gives it free.

    Raises:
        UserError: the cache cannot be written or locked, or who holds the lock stands still.
    """
    folder = name.folder
    with _disk_errors(folder):
        durable.make_folder(folder)
        handle = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        with _disk_errors(folder):
            _wait_for(handle, name)
        for left_behind in folder.glob(f"{_STAGING}*"):  # by a process that was killed
            shutil.rmtree(left_behind, ignore_errors=True)
        yield
    finally:
        os.close(handle)


def _wait_for(handle: int, name: DatasetName) -> None:
    """Lock the open file, and write into it who holds it now.

    Raises:
        UserError: its holder stands still.
    """
    waits = False
    while not locks.take(handle, name.folder / _LOCK):
        holder = _holder(handle)
        now, used = time.monotonic(), thread_times(holder) if holder else frozenset()
        if not waits:
            waits, logged, moved, before = True, now, now, used
            _log.warning("%s is making %s; waiting for it", _named(holder), name)
        if used != before or not holder or not thread_times(os.getpid()):  # or nothing is known
            moved, before = now, used
        if now - moved > _PATIENCE:
            raise UserError(
                f"{_named(holder)}, which is making {name}, has done nothing for {_PATIENCE:g} s:"
                f" end it (kill {holder}), and try again"
            )
        if now - logged > _LOG_EVERY:
            logged = now
            _log.warning("%s is still making %s", _named(holder), name)
        time.sleep(_LOOK)
    os.ftruncate(handle, 0)
    os.pwrite(handle, f"{os.getpid()} {socket.gethostname()}\n".encode(), 0)


def _holder(handle: int) -> int:
    """Process id that stands in the lock file; 0 if it is not on this machine."""
    pid, _, host = os.pread(handle, 300, 0).decode(errors="replace").strip().partition(" ")
    return int(pid) if host == socket.gethostname() and pid.isdecimal() else 0


def _named(pid: int) -> str:
    return f"process {pid}" if pid else "another process"


def publish(
    name: DatasetName, data: JointTransitions, made: Provenance, agents: Sequence[str] = ()
) -> DatasetCard:
    """Write a data set, all of it or nothing; the caller holds `locked`.

    Args:
        agents: whose files are written; empty: everybody's.

    Raises:
        UserError: the disk is full or cannot be written.
        ValueError: data that are not finite or contradict the environment's sizes.
    """
    folder = name.folder / str(len(data))
    with _disk_errors(folder):
        staging = Path(tempfile.mkdtemp(prefix=_STAGING, dir=name.folder))
        try:
            staging.chmod(0o755)
            card = _write(staging, name, data, made, agents)
            durable.sync(staging)
            if folder.exists():  # damaged or outdated: open files of it stay readable
                folder.rename(staging / "replaced")
            staging.rename(folder)
            shutil.rmtree(folder / "replaced", ignore_errors=True)
            durable.sync(folder.parent)
        except BaseException:
            shutil.rmtree(staging, ignore_errors=True)
            raise
    return card


def _write(
    folder: Path, name: DatasetName, data: JointTransitions, made: Provenance, agents: Sequence[str]
) -> DatasetCard:
    files = {}
    for index, agent in enumerate(registry.team_spec(name.env_id).agents):
        if agents and agent.name not in agents:
            continue
        header = Header(
            format_version=FORMAT_VERSION,
            dataset=str(name),
            env_id=name.env_id,
            agent=agent.name,
            transitions=len(data),
            observation_size=agent.observation_size,
            action_size=agent.action_size,
            origin=made.origin,
            versions=made.versions,
        )
        path = folder / f"{agent.name}.safetensors"
        durable.write(path, encode(header, data.of_agent(index), data.episodes))
        files[agent.name] = AgentFile.of(path, agent.observation_size, agent.action_size)
    card = DatasetCard(
        name=str(name),
        env_id=name.env_id,
        transitions=len(data),
        terminated=int(data.terminated.sum()),
        truncated=int(data.truncated.sum()),
        episodes=len(made.returns),
        incomplete_episodes=made.incomplete_episodes,
        returns=Summary.of(made.returns),
        normalised_score=Summary.of(normalised_scores(name.env_id, made.returns)),
        origin=made.origin,
        recipe=made.recipe,
        notes=made.notes,
        versions=made.versions,
        files=files,
    )
    durable.write(folder / FILE_NAME, card.to_json().encode())
    return card


def add_file(path: Path, content: bytes) -> None:
    """Write or replace one file of a set, in one step; the caller holds `locked`.

    Raises:
        UserError: the disk is full or cannot be written.
    """
    with _disk_errors(path.parent):
        durable.write(path, content)


@contextmanager
def _disk_errors(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        advice = (
            "free some space" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "check the folder"
        )
        raise UserError(
            f"cannot write {folder}: {error.strerror}; {advice}, or set OTC_DIST_CACHE to another"
        ) from None
