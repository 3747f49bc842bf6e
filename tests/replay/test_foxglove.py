"""Logs made into files for Foxglove, with what only the learners knew."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from tests.deployment_log.shown import shown
from tests.report.conftest import MadeRun

from .conftest import Replay
from .played import play


def contents(path: Path) -> list[tuple[str, int, Any]]:
    """Topic, time and content, in the order of time."""
    return [(each.topic, each.time, each.content) for each in shown(path)]


@pytest.fixture
def made(tmp_path: Path) -> MadeRun:
    """A run with two deployments' logs in it."""
    made = MadeRun(tmp_path / "run")
    for k in (1, 2):
        made.folder.deployment(k).unlink()
        play("hopper-3x1", made.folder.deployment(k), 20, deployment=k)
    return made


def test_all_deployments_with_alpha_and_similarity(
    made: MadeRun, tmp_path: Path, replay: Replay
) -> None:
    out = tmp_path / "out.mcap"
    logs = [made.folder.deployment(k) for k in (1, 2)]
    assert replay(*reversed(logs), "--foxglove", out) == (0, f"{out}\n")
    found = contents(out)
    steps = [(time, said) for topic, time, said in found if topic == "/step"]
    assert [said["step"] for _, said in steps] == [*range(20), *range(20)]
    assert steps[20][1]["episode"] > steps[19][1]["episode"]
    # What comes of a deployment is shown with its last step, and where the next one begins.
    for agent in ("agent_0", "agent_1"):
        tunings = [(time, said) for topic, time, said in found if topic == f"/{agent}/tuning"]
        assert tunings == [
            (steps[19][0], {"deployment": 1, "alpha": 1.0, "similarity": 3.0}),
            (steps[20][0], {"deployment": 1, "alpha": 1.0, "similarity": 3.0}),
            (steps[39][0], {"deployment": 2, "alpha": 0.5, "similarity": 1.5}),
        ]


def test_what_a_finished_log_has_already_is_the_same(
    made: MadeRun, tmp_path: Path, replay: Replay
) -> None:
    log, out = made.folder.deployment(2), tmp_path / "out.mcap"
    replay(log, "--foxglove", out)
    kept = [each for each in shown(out) if not each.topic.endswith("/tuning")]
    assert [(each[:3], each.data) for each in kept] == [
        (each[:3], each.data) for each in shown(log)
    ]


def test_an_unfinished_log(recorded, tmp_path: Path, replay: Replay) -> None:
    """Cut short, and in no run folder: its steps are there, alpha is not."""
    made, _ = recorded
    made.write(tmp_path / "log.mcap", 50).close()
    out = tmp_path / "out.mcap"
    replay(tmp_path / "log.mcap.partial", "--foxglove", out)
    found = contents(out)
    assert {topic for topic, _, _ in found} == {"/step"} and len(found) == 50


def test_an_episode_of_another_copy(made: MadeRun, tmp_path: Path, replay: Replay) -> None:
    out = tmp_path / "out.mcap"
    replay(made.folder.deployment(1), "--foxglove", out, "--episode", "1")
    first = next(said for topic, _, said in contents(out) if topic == "/step")
    assert first["episode"] == first["episode_step"] == 0
    assert first["episode_return"] == first["reward"]
    with out.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert {channel.metadata["copy"] for channel in summary.channels.values()} == {"1"}


def test_mistakes(made: MadeRun, recorded, tmp_path: Path, refused: Callable[..., str]) -> None:
    log, out = made.folder.deployment(1), tmp_path / "out.mcap"
    assert "--steps does nothing with" in refused(log, "--foxglove", out, "--steps", "0:5")
    again = shutil.copy(log, tmp_path / "again.mcap")
    assert "same deployment" in refused(log, again, "--foxglove", out)
    assert "one environment" in refused(log, recorded[1], "--foxglove", out)
    assert "exists; --force" in refused(log, "--foxglove", again)
    assert not out.exists()
