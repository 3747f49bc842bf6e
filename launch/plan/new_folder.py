"""A new run's folder: whether it can be made, and taking it away again where nothing came of it."""

import os
import shutil
from contextlib import suppress
from pathlib import Path

from otc_dist.run.folder import RunFolder
from otc_dist.system import durable
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


class NewFolder:
    """The folder of a run or a comparison that begins: what is refused leaves nothing of it behind.

    Attributes:
        given: files in it that look like work, and took none: copies from elsewhere.
    """

    def __init__(self, root: Path) -> None:
        """Make it, if it is not there, with those above it. Raises UserError."""
        self.root, self.given = root, set[Path]()
        try:
            self._above = [path for path in root.parents if not path.exists()]
            root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot make {root}: {error.strerror}") from None

    def take_away(self) -> bool:
        """Empty and remove it, if nothing in it took work, and what was made above it.

        So what was refused does not block its name. The caller holds the folder's lock.

        Returns:
            whether it is gone.
        """
        if {path for pattern in _PRODUCTS for path in self.root.glob(pattern)} - self.given:
            return False
        for path in self.root.iterdir() if self.root.exists() else ():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        with suppress(OSError):  # something may be mounted there, or others have begun beside it
            for path in (self.root, *self._above):
                path.rmdir()
        return True


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
        disk = os.statvfs(durable.room_for(folder.root))
    except OSError as error:
        raise UserError(f"cannot make the run folder {out}: {error.strerror}") from None
    free = disk.f_bavail * disk.f_frsize
    if free < needed:
        raise UserError(
            f"no disk space at {out}: about {_megabytes(needed)} are needed,"
            f" {_megabytes(free)} are free"
        )
    return folder


def make_folder(out: Path, needed: int) -> NewFolder:
    """Make a new run's. Raises UserError as `check_folder`."""
    return NewFolder(check_folder(out, needed).root)


def _free(folder: RunFolder) -> bool:
    """Whether nothing is in it but what a launcher leaves that was killed as it began."""
    begun = {folder.description.name, f"{folder.description.name}.partial"}
    begun |= {f"{folder.run_json.name}.partial", LOCK}
    found = {path.name for path in folder.root.iterdir()}
    return not found or (LOCK in found and found <= begun)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.0f} MB"
