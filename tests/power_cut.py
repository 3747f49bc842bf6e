"""A disk that keeps what was forced to it, and loses or keeps anything else as it likes."""

import os
import stat
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import pytest

State = dict[str, bytes]  # what a power cut leaves: paths below the root -> contents


class Disk:
    """What may be found under `root` after a power cut now.

    Of a file, its bytes at its last fsync or fdatasync, or those of now. Of a folder, the names at
    its last fsync; each name that has changed since is as it was or as it is now, whatever became
    of the others. What is there at the beginning is on the disk.

    `watch` looks at the disk before and after each change that a program can see the order of.
    """

    def __init__(self, root: Path, patch: pytest.MonkeyPatch) -> None:
        self._root = root
        self._contents: dict[int, bytes] = {}  # by inode
        self._names: dict[int, dict[str, int]] = {}  # by a folder's inode: name -> inode
        self._open: list[int] = []  # so that no inode's number is used again
        self._look: Callable[[State], None] | None = None
        self.syncs = 0  # of files
        for path in (root, *root.rglob("*")):
            self._sync_path(path)
        for name in ("fsync", "fdatasync"):
            patch.setattr(os, name, self._watched(self._forcing(getattr(os, name))))
        for name in ("rename", "replace", "unlink", "mkdir"):
            patch.setattr(os, name, self._watched(getattr(os, name)))

    def states(self) -> Iterator[State]:
        """All that may be there."""
        yield from self._folder(self._root.stat().st_ino, self._root, "")

    def watch(self, look: Callable[[State], None] | None) -> None:
        """From now on `look` is called with every state at every moment."""
        self._look = look

    def close(self) -> None:
        for handle in self._open:
            os.close(handle)

    def _watched(self, do: Callable[..., Any]) -> Callable[..., Any]:
        def done(*arguments: Any, **named: Any) -> Any:
            self._look_at_all()
            result = do(*arguments, **named)
            self._look_at_all()
            return result

        return done

    def _look_at_all(self) -> None:
        look, self._look = self._look, None  # what looks may write files of its own
        if look is not None:
            for state in self.states():
                look(state)
        self._look = look

    def _forcing(self, force: Callable[[int], None]) -> Callable[[int], None]:
        def forced(handle: int) -> None:
            force(handle)
            self._sync_path(Path(f"/proc/self/fd/{handle}"))
            self.syncs += stat.S_ISREG(os.fstat(handle).st_mode)

        return forced

    def _sync_path(self, path: Path) -> None:
        handle = os.open(path, os.O_RDONLY)
        self._open.append(handle)
        inode = os.fstat(handle).st_ino
        if path.is_dir():
            self._names[inode] = _names(path)
        else:
            self._contents[inode] = path.read_bytes()

    def _folder(self, inode: int, path: Path | None, prefix: str) -> Iterator[State]:
        """`path`: where it is now; None: nowhere."""
        before = self._names.get(inode, {})
        now = _names(path) if path is not None else before
        names = sorted(before.keys() | now.keys())
        choices = [sorted({before.get(name, 0), now.get(name, 0)}) for name in names]
        for chosen in product(*choices):
            parts = [
                list(self._entry(inode, path and path / name, prefix + name, now.get(name)))
                for name, inode in zip(names, chosen, strict=True)
                if inode
            ]
            for entries in product(*parts):
                yield {name: data for part in entries for name, data in part.items()}

    def _entry(self, inode: int, path: Path | None, name: str, now: int | None) -> Iterator[State]:
        there = path if path is not None and inode == now else None
        if inode in self._names or (there is not None and there.is_dir()):
            yield from self._folder(inode, there, f"{name}/")
            return
        contents = {self._contents.get(inode, b"")}
        if there is not None:
            contents.add(there.read_bytes())
        yield from ({name: data} for data in sorted(contents))


def _names(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_ino for path in folder.iterdir()}
