"""A recording to import, and a cache of the test's own to import it into."""

from pathlib import Path

import pytest

from .recordings import Played, play


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture(scope="session")
def played() -> Played:
    """About 20 hopper episodes, of which some fell and some were cut, and a last open one."""
    played = play("hopper-1x3", 301)
    assert played.terminals.any()
    assert played.timeouts.any()
    assert not played.terminals[-1]
    assert not played.timeouts[-1]
    return played


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "hopper_medium-v2.hdf5"
