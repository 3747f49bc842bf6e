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
# What a launcher leaves that is killed before anything takes work.
_BEGUN = {LOCK, "description.toml", "description.toml.partial", "run.json.partial"}
_BEGUN_TO_COMPARE = {"inputs.json", "inputs.json.partial", "output", "quick", "quick.partial"}


class NewFolder:
    """The folder of a run or a comparison that begins: what is refused leaves nothing of it behind.

    It may be one that was begun before, to which something is added: what is refused then leaves
    nothing new.

    Attributes:
        given: files that come into it and took no work: copies from elsewhere, what a process said.
    """

    def __init__(self, root: Path) -> None:
        """Make it, if it is not there, with those above it. Raises UserError."""
        self.root, self.given = root, set[Path]()
        try:
            there = root.iterdir() if root.exists() else ()
            self._ours = {path.name for path in there} <= _BEGUN | _BEGUN_TO_COMPARE
            self._above = [path for path in root.parents if not path.exists()]
            root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot make {root}: {error.strerror}") from None
        self._before = self._work()

    def _work(self) -> set[Path]:
        return {path for pattern in _PRODUCTS for path in self.root.glob(pattern)}

    def take_back(self) -> bool:
        """Remove what was given, unless anything in the folder has taken work since.

        Returns:
            whether nothing has.
        """
        if self._work() - self._before - self.given:
            return False
        for path in self.given:
            _remove(path, self.root)
        return True

    def take_away(self) -> bool:
        """Empty and remove it, and what was made above it.

        So what was refused does not block its name. It stays if anything in it took work, or was
        there before: except for what a launcher leaves that was killed as it began. What
        `take_back` takes goes in any case. The caller holds the folder's lock.

        Returns:
            whether it is gone.
        """
        if not self.take_back() or not self._ours:
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


def _remove(path: Path, root: Path) -> None:
    """A file, and the folders below `root` that it leaves empty."""
    path.unlink(missing_ok=True)
    with suppress(OSError):  # not empty, or never made
        for folder in path.parents:
            if folder == root:
                break
            folder.rmdir()


def check_folder(out: Path, needed: int) -> RunFolder:
    """See that a new run's folder can be made, with room for `needed` bytes; nothing is made.

    Raises:
        UserError: it exists and is not empty, cannot be written, or the disk is too full.
    """
    folder = RunFolder(out.resolve())
    try:
        if folder.root.exists() and not _free(folder.root):
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


def _free(root: Path) -> bool:
    """Whether a folder is empty, but for what a launcher leaves that was killed as it began."""
    found = {path.name for path in root.iterdir()}
    return not found or (LOCK in found and found <= _BEGUN)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.0f} MB"
