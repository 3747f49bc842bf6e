"""Offline policies that comparisons share: what one has trained, others of the same take.

    <cache>/policies/<key>.safetensors

<cache> is that of `otc_dist.system.cache`, and the key a digest of all that the bytes of an agent's
pi_0 depend on. Entries are whole or not there; the least recently used go when there are too many.
A cache that cannot be read or written is one line, and costs time only.
"""

import functools
import hashlib
import json
import logging
import os
import platform
import secrets
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import otc_dist
from otc_dist.datasets import inputs, store
from otc_dist.datasets.card import file_sha256
from otc_dist.description import Description
from otc_dist.learner import checkpoint
from otc_dist.system import durable
from otc_dist.system.cache import cache_root
from otc_dist.system.processor import kind
from otc_dist.system.versions import PACKAGES, of_packages
from otc_dist.terminal.errors import UserError

LIMIT = 2**30  # bytes of all entries; one is about a megabyte
SUFFIX = ".safetensors"
UNFINISHED = 3600.0  # seconds, after which nobody is writing a file any more
log = logging.getLogger(__name__)


def fetch(description: Description, agent: str, wanted: Path, together: Sequence[int] = ()) -> bool:
    """Put the pi_0 of a description's agent at `wanted`, if it is in the cache and sound.

    Args:
        together: the seeds whose offline updates would be made at once, its own among them.

    Raises:
        UserError: the environment or the code that a description names cannot be loaded.
    """
    if not _data(description, agent).exists():
        return False
    entry, new = _entry(description, agent, together), wanted.with_suffix(".fetched")
    try:
        content = entry.read_bytes()
        durable.write(new, content)  # what is checked is what is used, whoever replaces the entry
        _check(new, description, agent)
        new.replace(wanted)
        os.utime(entry)
    except FileNotFoundError:
        return False
    except (OSError, UserError) as error:
        log.warning("an offline policy is trained again: %s cannot be used (%s)", entry, error)
        for path in (entry, new):
            with suppress(OSError):
                path.unlink()
        return False
    return True


def keep(description: Description, agent: str, made: Path, together: Sequence[int] = ()) -> None:
    """Put the pi_0 that a description's agent has at `made` into the cache.

    Args:
        together: the seeds whose offline updates were made at once; none: its own alone.

    Raises:
        UserError: as `fetch`.
    """
    try:
        entry = _entry(description, agent, together)
        entry.parent.mkdir(parents=True, exist_ok=True)
        suffix = f".{secrets.token_hex(8)}"  # others may be writing the same entry
        with durable.writing(entry, suffix, lasting=False) as file:
            file.write(made.read_bytes())
        _make_room(entry.parent)
    except OSError as error:
        log.warning("an offline policy is not kept for other comparisons: %s", error)


def _make_room(folder: Path) -> None:
    """Remove the least recently used entries, and what was left unfinished, beyond the limit."""
    begun = time.time() - UNFINISHED
    found: list[tuple[float, int, Path]] = []
    for path in folder.iterdir():
        with suppress(FileNotFoundError):  # another process makes room as well
            status = path.stat()
            if path.suffix == SUFFIX or status.st_mtime < begun:
                found.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= LIMIT:
            break
        path.unlink(missing_ok=True)
        total -= size


def _check(path: Path, description: Description, agent: str) -> None:
    """Raises UserError if a checkpoint is damaged, or not the pi_0 of this agent."""
    _, found = checkpoint.read(path)
    if (found.agent, found.offline_digest, found.tuned) != (agent, description.offline_digest(), 0):
        raise UserError("it is another policy's")


def _entry(description: Description, agent: str, together: Sequence[int]) -> Path:
    """Where the pi_0 of a description's agent lies, or would lie."""
    depends_on = {
        "agent": agent,
        "offline": description.offline_digest(),
        "data": _digest(path := _data(description, agent), path.stat().st_mtime_ns),
        "together": sorted({description.seed, *together}),
        "own code": {**inputs.sources(description), **inputs.code(description)},
        **surroundings(),
    }
    key = hashlib.sha256(json.dumps(depends_on, sort_keys=True).encode()).hexdigest()[:32]
    return cache_root() / "policies" / f"{key}{SUFFIX}"


def surroundings() -> dict[str, object]:
    """What the bytes of a policy depend on beside its description and its data."""
    return {
        "package": _package(),
        "versions": {"python": platform.python_version(), **of_packages(*PACKAGES)},
        "processor": kind(),
    }


def _data(description: Description, agent: str) -> Path:
    return store.agent_file(description.dataset.name, agent, description.dataset.transitions)


@functools.lru_cache
def _digest(path: Path, changed: int) -> str:
    """Of a data file that was last changed then: ten seeds have the same."""
    return file_sha256(path)


@functools.cache
def _package() -> str:
    """Of this package's sources: versions are not counted up between two commits."""
    root, total = Path(otc_dist.__file__).parent, hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.cpp")]):
        total.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return total.hexdigest()
