"""Files that are there whole or not at all: `otc_dist.system.durable`."""

import errno
import os
from contextlib import closing
from pathlib import Path

import pytest

from otc_dist.system import durable

from ..power_cut import Disk


def test_a_file_is_replaced_and_its_folders_made(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "file.json"
    durable.write(path, b"old")
    durable.write(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("before", [None, b"old"])
def test_a_power_cut_leaves_the_old_or_the_new_and_afterwards_the_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: bytes | None
) -> None:
    root = tmp_path / "disk"
    path = root / "new" / "folder" / "file.json"
    root.mkdir()
    if before is not None:
        durable.write(path, before)
    with closing(Disk(root, monkeypatch)) as disk:
        found: set[bytes | None] = set()
        disk.watch(lambda state: found.add(state.get("new/folder/file.json")))
        durable.write(path, b"new")
        disk.watch(None)
        assert found == {before, b"new"}
        assert {state["new/folder/file.json"] for state in disk.states()} == {b"new"}
        monkeypatch.undo()


def test_a_full_disk_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file.json"
    durable.write(path, b"old")

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space left"):
        durable.write(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_ends_unfinished_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    durable.write(path, b"old", mode=0o600)
    with pytest.raises(KeyboardInterrupt), durable.writing(path, ".new", lasting=False) as file:
        file.write(b"new")
        assert {one.name for one in tmp_path.iterdir()} == {"file.json", "file.json.new"}
        raise KeyboardInterrupt
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (b"old", 0o600)
    assert list(tmp_path.iterdir()) == [path]
