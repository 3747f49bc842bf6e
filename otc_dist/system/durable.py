"""Writing a file so that it is there whole, whatever happens, or not at all."""

import errno
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import BinaryIO

from otc_dist.terminal.errors import UserError

log = logging.getLogger(__name__)


def write(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Replace `path` in one step, on the disk: a crash leaves the old file or the new one.

    Folders are made. Once this has returned, a power cut takes nothing of it.

    Args:
        mode: who may read and write it, less the process's umask.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    make_folder(path.parent)
    with writing(path, mode=mode) as file:
        file.write(content)


def put(path: Path, content: bytes) -> None:
    """As `write`. Raises UserError, one line that says why, if it cannot be written."""
    try:
        write(path, content)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None


@contextmanager
def writing(
    path: Path, suffix: str = ".partial", *, mode: int = 0o666, lasting: bool = True
) -> Iterator[BinaryIO]:
    """A file that becomes `path` when the block ends well, and is removed when it does not.

    Args:
        suffix: what its name ends in until then.
        mode: see `write`.
        lasting: no power cut takes anything of it; otherwise only a crash does not.

    Raises:
        OSError: see `write`.
    """
    unfinished = path.with_name(path.name + suffix)
    try:
        with open(unfinished, "wb", opener=lambda at, flags: os.open(at, flags, mode)) as file:
            yield file
            if lasting:
                file.flush()
                os.fsync(file.fileno())
        unfinished.replace(path)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink()
        raise
    if lasting:
        sync(path.parent)


def room_for(path: Path) -> Path:
    """See that a folder can be made at `path`, or written in if it is there; nothing is made.

    Returns:
        the nearest one that is there: itself, or one above it.

    Raises:
        UserError: that is no folder, or may not be written in.
    """
    try:
        there = next(one for one in (path, *path.parents) if one.exists())
        if not there.is_dir():
            raise UserError(f"cannot make {path}: {there} is not a folder")
    except OSError as error:
        raise UserError(f"cannot make {path}: {error.strerror}") from None
    if not os.access(there, os.W_OK | os.X_OK):
        raise UserError(f"cannot write to {there}: permission denied")
    return there


def make_folder(path: Path) -> None:
    """Make a folder, and those that it lies in, so that they stay. Raises OSError."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    path.mkdir(parents=True, exist_ok=True)
    for folder in missing:
        sync(folder.parent)  # which holds its name


def sync(path: Path) -> None:
    """Force a file, or the names in a folder, to the disk.

    Of a folder whose file system cannot do that, it is said in one line.

    Raises:
        OSError: the disk is full, ...
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS) or not path.is_dir():
            raise
        _warn(path)
    finally:
        os.close(handle)


@cache
def _warn(folder: Path) -> None:
    log.warning(
        "%s is on a file system whose folders cannot be forced to the disk: a power cut may undo"
        " the newest changes of names there",
        folder,
    )
