"""Where the bus of one machine lies: in the run's own folder, or in the next place that will do."""

import errno
import fcntl
import os
import socket
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from otc_dist.bus import endpoints
from otc_dist.bus.endpoints import local_endpoint, local_socket, remove_local_endpoint
from otc_dist.terminal.errors import UserError

LONG = "long" * 30  # no socket has so long a path


@pytest.fixture
def temporary(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A temporary folder of the test's own, whose path is short."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:
        monkeypatch.setattr(tempfile, "tempdir", folder)
        yield Path(folder)


def lies_in(run: Path) -> Path:
    found = local_socket(local_endpoint(run))
    assert found is not None
    return found.parent


def test_it_is_in_the_run_s_own_folder_which_only_its_user_enters(temporary: Path) -> None:
    run = temporary / "run"
    run.mkdir()
    before = os.umask(0o777)
    try:
        folder = lies_in(run)
    finally:
        os.umask(before)
    assert folder.parent == run and stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert lies_in(run) == folder and list(folder.iterdir()) == []
    remove_local_endpoint(local_endpoint(run))
    assert list(run.iterdir()) == []


def test_what_it_did_not_make_is_not_removed(temporary: Path) -> None:
    (temporary / "bus").touch()
    remove_local_endpoint(f"unixsock-stream/{temporary}/bus")
    remove_local_endpoint("tls/192.0.2.1:7447")
    assert (temporary / "bus").exists()
    assert local_socket(f"unixsock-stream/{temporary}/bus") is None


def test_of_a_run_with_a_long_path_it_is_in_the_temporary_folder(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the login's own folder is, which goes with the login or is another user's."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/root/of/somebody/else")
    temporary.chmod(0o2770)  # what is made in it inherits the bit
    folder = lies_in(temporary / LONG)
    assert folder.parent == temporary and folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o2700)
    assert lies_in(temporary / LONG) == folder
    assert folder != lies_in(temporary / (LONG + "2"))
    remove_local_endpoint(local_endpoint(temporary / LONG))
    assert not folder.exists()


def test_where_the_temporary_folder_s_path_is_long_as_well_it_is_in_the_next(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(temporary / LONG))
    folder = lies_in(temporary / LONG)
    assert folder.parent == Path("/tmp")
    folder.rmdir()


def test_where_no_disk_has_locks_it_is_in_memory(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = temporary / "run"
    run.mkdir()
    flock = fcntl.flock

    def on_memory_alone(file: int, operation: int) -> None:
        if not os.readlink(f"/proc/self/fd/{file}").startswith("/dev/shm/"):  # noqa: PTH115
            raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))
        flock(file, operation)

    monkeypatch.setattr("fcntl.flock", on_memory_alone)
    folder = lies_in(run)
    assert folder.parent == Path("/dev/shm") and list(run.iterdir()) == []
    remove_local_endpoint(local_endpoint(run))
    assert not folder.exists()


class _NoSockets(socket.socket):
    """As on a file system that has none."""

    def bind(self, address: object) -> None:
        assert isinstance(address, str)
        if ".bus" in address:
            raise OSError(errno.EPERM, os.strerror(errno.EPERM))
        super().bind(address)


def _no_locks(file: int, operation: int) -> None:
    """As on a file system that has none."""
    if ".bus" in os.readlink(f"/proc/self/fd/{file}"):  # noqa: PTH115
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))


@pytest.mark.parametrize("why", ["no sockets", "no locks", "read only", "a file"])
def test_where_the_run_s_folder_will_not_do_it_is_in_the_temporary_one(
    temporary: Path, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    run = temporary / "run"
    if why == "no sockets":
        run.mkdir()
        monkeypatch.setattr(endpoints.socket, "socket", _NoSockets)
    elif why == "no locks":
        run.mkdir()
        monkeypatch.setattr("fcntl.flock", _no_locks)
    elif why == "a file":
        run.touch()
    else:
        run = Path("/proc/self/run")
    assert lies_in(run).parent == temporary


@pytest.mark.parametrize("whose", ["another's", "open to others", "a file"])
def test_a_folder_that_somebody_has_made_for_us_is_one_line(
    temporary: Path, monkeypatch: pytest.MonkeyPatch, whose: str
) -> None:
    folder = lies_in(temporary / LONG)
    if whose == "another's":
        monkeypatch.setattr(Path, "lstat", _of_another(folder, Path.lstat))
    elif whose == "open to others":
        folder.chmod(0o755)
    else:
        folder.rmdir()
        folder.touch()
    with pytest.raises(UserError, match="mode 0700; remove it, or set TMPDIR") as error:
        local_endpoint(temporary / LONG)
    assert str(folder) in str(error.value) and "\n" not in str(error.value)


def test_another_user_who_looks_at_a_run_has_a_bus_of_his_own(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = temporary / "run"
    run.mkdir()
    ours, uid = lies_in(run), os.getuid()
    monkeypatch.setattr(Path, "lstat", _of_another(ours, Path.lstat))
    assert lies_in(run).name.startswith(f"otc-{uid}-")


def _of_another(folder: Path, lstat: object) -> object:
    def told(path: Path) -> os.stat_result:
        status = list(lstat(path))  # type: ignore[operator]
        if path == folder:
            status[stat.ST_UID] += 1
        return os.stat_result(status)

    return told


def test_no_place_at_all_is_one_line_that_names_the_variable_to_set(
    temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(temporary / LONG))
    monkeypatch.setattr(endpoints, "_LONGEST_SOCKET_PATH", 20)
    with pytest.raises(UserError, match="set TMPDIR to one of yours with a short path") as error:
        local_endpoint(temporary / LONG)
    assert "\n" not in str(error.value)
