"""`--recover` writes what is whole to a log of its own, whole or not at all."""

import resource
from pathlib import Path

import pytest

from otc_dist.deployment_log.reader import read_steps, read_summary
from tests.deployment_log.conftest import Recording, same_step


def damaged(recorded: tuple[Recording, Path], folder: Path) -> Path:
    """A copy of the finished log with a hole in its middle, and without its end."""
    data = bytearray(recorded[1].read_bytes()[:-1000])
    data[len(data) // 2 : len(data) // 2 + 100] = bytes(100)
    path = folder / "log.mcap"
    path.write_bytes(data)
    return path


def test_every_whole_step_is_in_the_new_log(
    recorded: tuple[Recording, Path], tmp_path: Path, replay
) -> None:
    made, _ = recorded
    path = damaged(recorded, tmp_path)
    status, told = replay(path, "--recover")
    out = tmp_path / "log.recovered.mcap"
    assert status == 1  # some are missing
    assert told.startswith(f"{out}: ") and "missing: steps " in told
    steps = list(read_steps(out))
    assert 600 < len(steps) < 1200
    assert all(same_step(step, made.steps[step.step]) for step in steps)
    summary = read_summary(out)
    assert summary.finished and summary.steps == len(steps) and len(summary.ranges) == 2
    assert "gaps          steps" in replay(out)[1]


def test_an_unfinished_log_becomes_a_finished_one(tmp_path: Path, replay) -> None:
    made = Recording(((3, 1), (2, 2)), copies=2, steps=12)
    made.write(tmp_path / "log.mcap").close()
    partial = tmp_path / "log.mcap.partial"
    partial.write_bytes(partial.read_bytes()[:-1])
    assert replay(partial, "--recover", "--out", tmp_path / "new.mcap")[0] == 0
    steps = list(read_steps(tmp_path / "new.mcap"))
    assert len(steps) == 11
    assert all(map(same_step, steps, made.steps))


def test_what_exists_is_kept_without_force(
    recorded: tuple[Recording, Path], tmp_path: Path, replay, refused
) -> None:
    path, out = damaged(recorded, tmp_path), tmp_path / "out.mcap"
    out.write_text("precious")
    assert "--force replaces it" in refused(path, "--recover", "--out", out)
    assert out.read_text() == "precious"
    replay(path, "--recover", "--out", out, "--force")
    assert read_summary(out).steps > 600


@pytest.mark.parametrize("content", [b"", b"a,b\n" * 999])
def test_nothing_to_recover_leaves_nothing(tmp_path: Path, refused, content: bytes) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    assert str(path) in refused(path, "--recover")
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


def test_a_full_disk_leaves_nothing(
    recorded: tuple[Recording, Path], tmp_path: Path, refused
) -> None:
    path = damaged(recorded, tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        message = refused(path, "--recover")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert message == f"cannot write {tmp_path / 'log.recovered.mcap'}: File too large"
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]
