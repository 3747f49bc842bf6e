"""Locks that the kernel lets go when their holder ends, where the file system has them."""

import errno
import fcntl
import logging
import time
from functools import cache
from pathlib import Path

log = logging.getLogger(__name__)

# What file systems without such locks answer: Lustre without -o flock, NFS without its daemon.
_NONE = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL)
_LOOKS = 5  # somebody may only be looking whether it is held
_PAUSE = 0.05  # seconds between two of them


def take(file: int, path: Path) -> bool:
    """Hold an open file, for writing, against all others; False if another process does.

    Where its file system has no locks, that is said in one line, and everybody holds it.

    Args:
        path: for the line.
    """
    try:
        for look in range(_LOOKS):
            if look:
                time.sleep(_PAUSE)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return True
            except BlockingIOError:
                continue
        return False
    except OSError as error:
        if error.errno not in _NONE:
            raise
        _warn(path.parent)
        return True


def held(file: int) -> bool | None:
    """Whether another process holds an open file; None where its file system has no locks."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError as error:
        if error.errno not in _NONE:
            raise
        return None
    fcntl.flock(file, fcntl.LOCK_UN)
    return False


@cache
def _warn(folder: Path) -> None:
    log.warning(
        "%s is on a file system without locks: nothing stops a second process from writing there",
        folder,
    )
