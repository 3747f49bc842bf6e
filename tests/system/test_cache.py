"""The cache: where code that is run may lie, and where not."""

import os
import stat
from pathlib import Path

import pytest

from otc_dist.system.cache import compiled_root
from otc_dist.terminal.errors import UserError


@pytest.fixture
def root(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """$OTC_DIST_CACHE, made; the user's own cache folder is `tmp_path`/home."""
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    (tmp_path / "cache").mkdir()
    return tmp_path / "cache"


def test_the_folder_is_private_whatever_the_umask(root: Path) -> None:
    before = os.umask(0)
    try:
        folder = compiled_root()
    finally:
        os.umask(before)
    assert folder.parent == root and compiled_root() == folder
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@pytest.mark.parametrize(("mode", "taken"), [(0o777, "home"), (0o775, "home"), (0o1777, "cache")])
def test_where_others_can_replace_it_the_users_own_cache_is_taken(
    root: Path, tmp_path: Path, mode: int, taken: str
) -> None:
    root.chmod(mode)
    assert compiled_root().is_relative_to(tmp_path / taken)


@pytest.mark.parametrize("prepared", ["open to all", "a link", "a file", "another user's"])
def test_what_somebody_else_prepared_is_refused(
    root: Path, tmp_path: Path, prepared: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = root / f"compiled-{os.getuid()}"
    if prepared == "a link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "theirs")
    elif prepared == "a file":
        folder.touch()
    else:
        folder.mkdir(mode=0o700)
        if prepared == "open to all":
            folder.chmod(0o777)
        elif os.getuid() == 0:
            root.chmod(0o1777)
            os.chown(folder, 12345, 12345)
        else:
            pytest.skip("only root can give a folder away")
    with pytest.raises(
        UserError, match=r"/compiled-\d+ (for compiled code: File exists|holds code.*delete it)"
    ):
        compiled_root()
