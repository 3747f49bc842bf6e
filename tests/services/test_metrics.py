"""metrics.jsonl: every line is whole, whatever happened to the process that wrote it."""

import errno
import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from otc_dist.run.folder import RunFolder
from otc_dist.services.metrics import MetricsFile


@dataclass(frozen=True)
class Progress:
    phase: str = "offline"
    deployment: int = 0
    update: int = 100
    updates: int = 200
    metrics: dict[str, float] = field(default_factory=lambda: {"loss": 1.0})


def lines(path: Path) -> list[int]:
    """The updates that the lines tell; each must be JSON."""
    return [json.loads(line)["update"] for line in path.read_text().splitlines()]


@pytest.mark.parametrize("torn", [b"", b"{", b'{"phase": "offline", "deplo'])
def test_a_line_that_was_torn_is_cut_off_and_swallows_no_other(torn: bytes, tmp_path: Path) -> None:
    path = RunFolder(tmp_path).metrics("agent_0")
    MetricsFile(path).write(Progress(update=100))
    with path.open("ab") as file:
        file.write(torn)
    MetricsFile(path).write(Progress(update=200))
    assert lines(path) == [100, 200]


def test_a_line_that_does_not_fit_on_the_disk_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "metrics.jsonl"
    file, write, room = MetricsFile(path), os.write, 10
    file.write(Progress(update=100))

    def full(handle: int, content: bytes) -> int:
        nonlocal room
        if not room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written, room = write(handle, content[:room]), 0
        return written

    with monkeypatch.context() as patch:
        patch.setattr("os.write", full)
        with pytest.raises(OSError, match="No space"):
            file.write(Progress(update=150))
    file.write(Progress(update=200))
    assert lines(path) == [100, 200]
