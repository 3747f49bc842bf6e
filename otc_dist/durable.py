"""Writing a file so that it is there whole, whatever happens, or not at all."""

import errno
import logging
import os
from contextlib import suppress
from functools import cache
from pathlib import Path

log = logging.getLogger(__name__)


def write(path: Path, content: bytes) -> None:
    """Replace `path` in one step, on the disk: a crash leaves the old file or the new one.

    Folders are made. Once this has returned, a power cut takes nothing of it.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    make_folder(path.parent)
    unfinished = path.with_name(f"{path.name}.partial")
    try:
        with unfinished.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError:
        with suppress(OSError):
            unfinished.unlink()
        raise
    sync(path.parent)


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
        _tell(path)
    finally:
        os.close(handle)


@cache
def _tell(folder: Path) -> None:
    log.warning(
        "%s is on a file system whose folders cannot be forced to the disk: a power cut may undo"
        " the newest changes of names there",
        folder,
    )
