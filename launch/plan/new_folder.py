"""A new run's folder: whether it can be made, and taking it away again where nothing came of it."""

import os
import shutil
from contextlib import suppress
from pathlib import Path

from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

from .run_record import LOCK

# What takes work: checkpoints, logs, evaluations, and a comparison's raw scores.
_PRODUCTS = (
    "agents/*/*.safetensors",
    "deployments/*",
    "evaluations/*",
    "seeds/**/*.safetensors",
    "seeds/**/*.json",
    "mechanism/*/*",
)


def check_folder(out: Path, needed: int) -> RunFolder:
    """See that a new run's folder can be made, with room for `needed` bytes; nothing is made.

    Raises:
        UserError: it exists and is not empty, cannot be written, or the disk is too full.
    """
    folder = RunFolder(out.resolve())
    try:
        if folder.root.exists() and not _free(folder):
            hint = f"--resume {out}, or " if folder.run_json.exists() else ""
            raise UserError(f"{out} exists already; use {hint}another --out")
        there = next(path for path in (folder.root, *folder.root.parents) if path.exists())
        if not there.is_dir():
            raise UserError(f"cannot make the run folder {out}: {there} is not a folder")
        if not os.access(there, os.W_OK | os.X_OK):
            raise UserError(f"cannot write to {there}: permission denied")
        disk = os.statvfs(there)
    except OSError as error:
        raise UserError(f"cannot make the run folder {out}: {error.strerror}") from None
    free = disk.f_bavail * disk.f_frsize
    if free < needed:
        raise UserError(
            f"no disk space at {out}: about {_megabytes(needed)} are needed,"
            f" {_megabytes(free)} are free"
        )
    return folder


def make_folder(out: Path, needed: int) -> RunFolder:
    """Make it. Raises UserError as `check_folder`."""
    folder = check_folder(out, needed)
    try:
        folder.root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot make the run folder {out}: {error.strerror}") from None
    return folder


def take_away(root: Path, origin: bool = False) -> bool:
    """Empty and remove the folder of a run or a comparison, if nothing in it took work.

    So what was refused does not block its name. The caller holds the folder's lock.

    Args:
        origin: whether the policies pi_0 in it are those of another run.

    Returns:
        whether it is gone.
    """
    made = {path for pattern in _PRODUCTS for path in root.glob(pattern)}
    if origin:
        made -= {RunFolder(root).checkpoint(path.parent.name, 0) for path in made}
    if made:
        return False
    for path in root.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    with suppress(OSError):  # something may be mounted there: an empty folder blocks nothing
        root.rmdir()
    return True


def _free(folder: RunFolder) -> bool:
    """Whether nothing is in it but what a launcher leaves that was killed as it began."""
    begun = {folder.description.name, f"{folder.description.name}.partial"}
    begun |= {f"{folder.run_json.name}.partial", LOCK}
    found = {path.name for path in folder.root.iterdir()}
    return not found or (LOCK in found and found <= begun)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.0f} MB"
