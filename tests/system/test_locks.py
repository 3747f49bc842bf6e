"""File systems without locks, or whose folders cannot be forced to the disk: one line, and on."""

import errno
import fcntl
import logging
import os
import stat
from pathlib import Path

import pytest

from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import locked
from otc_dist.launch.plan import run_record
from otc_dist.run.folder import RunFolder
from otc_dist.system import durable, locks
from otc_dist.terminal.errors import UserError


@pytest.fixture
def said(caplog: pytest.LogCaptureFixture) -> pytest.LogCaptureFixture:
    """What is said, once for a folder."""
    caplog.set_level(logging.WARNING)
    return caplog


def test_a_lock_is_held_against_others_and_seen_without_write_access(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    assert run_record.launched(folder) is False  # and made nothing
    assert list(tmp_path.iterdir()) == []
    with run_record.locked(folder):
        assert run_record.launched(folder) is True
        with pytest.raises(UserError, match="another launcher"), run_record.locked(folder):
            pass
    assert run_record.launched(folder) is False


def test_somebody_who_looks_does_not_keep_a_launcher_out(tmp_path: Path) -> None:
    file = os.open(tmp_path / ".lock", os.O_RDWR | os.O_CREAT)
    looking = os.open(tmp_path / ".lock", os.O_RDONLY)
    fcntl.flock(looking, fcntl.LOCK_SH)
    pauses: list[float] = []

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        fcntl.flock(looking, fcntl.LOCK_UN)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(locks.time, "sleep", pause)
        assert locks.take(file, tmp_path / ".lock")
    assert len(pauses) == 1
    os.close(looking)
    os.close(file)


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK, errno.EINVAL])
def test_without_locks_all_goes_on_and_one_line_says_what_is_lost(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: pytest.LogCaptureFixture
) -> None:
    def refuse(file: int, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    folder = RunFolder(tmp_path)
    for _ in range(2):
        with run_record.locked(folder):
            assert run_record.launched(folder) is None
    with locked(DatasetName("hopper-3x1", "mine")):
        pass
    assert [line.partition(" is on ")[2] for line in said.messages] == [
        "a file system without locks: nothing stops a second process from writing there"
    ] * 2  # the run folder, and the cache's


def test_a_lock_that_fails_otherwise_is_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(file: int, operation: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(fcntl, "flock", fail)
    with pytest.raises(OSError, match="Input/output"), run_record.locked(RunFolder(tmp_path)):
        pass


def test_folders_that_cannot_be_synced_cost_one_line_and_files_are_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: pytest.LogCaptureFixture
) -> None:
    fsync, synced = os.fsync, []

    def refuse(file: int) -> None:
        if stat.S_ISDIR(os.fstat(file).st_mode):
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        synced.append(file)
        fsync(file)

    monkeypatch.setattr("os.fsync", refuse)
    for content in (b"old", b"new"):
        durable.write(tmp_path / "file", content)
    assert (tmp_path / "file").read_bytes() == b"new" and len(synced) == 2
    (line,) = said.messages
    assert line.startswith(f"{tmp_path} is on a file system whose folders cannot be forced")


def test_a_folder_that_fails_otherwise_is_no_such_file_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(file: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="Input/output"):
        durable.sync(tmp_path)
