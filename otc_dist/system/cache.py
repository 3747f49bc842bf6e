"""Where what can be made again is kept: data sets and compiled code."""

import os
import stat
from pathlib import Path

import platformdirs

from otc_dist.terminal.errors import UserError


def cache_root() -> Path:
    """$OTC_DIST_CACHE, or the user's cache folder."""
    chosen = os.environ.get("OTC_DIST_CACHE")
    return Path(chosen) if chosen else _own_root()


def compiled_root() -> Path:
    """The folder of this user's compiled code, made if absent: nobody else may enter it.

    Whoever can write there has us run what he wrote. So it lies in the user's own cache folder,
    whatever $OTC_DIST_CACHE says, if others can write in the latter, as in one that is shared.

    Raises:
        UserError: it cannot be made, is somebody else's, or others may enter it.
    """
    root = cache_root()
    try:
        root.mkdir(parents=True, exist_ok=True)
        if not _only_owner_renames(root):
            root = _own_root()
            root.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder = root / f"compiled-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except OSError as error:
        raise UserError(
            f"cannot make the folder {error.filename or root} for compiled code: {error.strerror};"
            " set OTC_DIST_CACHE to another"
        ) from None
    private = stat.S_ISDIR(status.st_mode) and not status.st_mode & 0o077
    if not private or status.st_uid != os.getuid():
        raise UserError(
            f"{folder} holds code that is run, so it must be a folder of yours that nobody else may"
            " enter (mode 0700): delete it, or set OTC_DIST_CACHE to another"
        )
    return folder


def _own_root() -> Path:
    return platformdirs.user_cache_path("otc_dist", appauthor=False)


def _only_owner_renames(folder: Path) -> bool:
    """Whether nobody but this user and root can replace what this user has put into `folder`."""
    status = folder.stat()
    others_write, sticky = status.st_mode & 0o022, status.st_mode & stat.S_ISVTX
    return status.st_uid in (os.getuid(), 0) and (not others_write or bool(sticky))
