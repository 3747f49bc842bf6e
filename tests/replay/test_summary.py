"""The summary says what is in a log, and reads no more of it than it must."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from otc_dist.deployment_log.format import partial_path
from otc_dist.deployment_log.reader import read_steps, read_summary
from tests.deployment_log.conftest import Recording


def test_it_tells_run_agents_steps_episodes_returns_policies_versions_gaps(
    recorded: tuple[Recording, Path], replay
) -> None:
    made, path = recorded
    status, output = replay(path)
    assert status == 0
    episodes = read_summary(path).episodes
    ended = [e for e in episodes if e.terminated or e.truncated]
    returns = np.array([np.mean(e.returns) for e in ended])
    lines = {line[2:16].strip(): line[16:] for line in output.splitlines()[1:]}
    assert output.startswith(str(path))
    assert lines["run"] == "a-run, deployment 3, seed 7"
    assert lines["state"] == "finished"
    assert lines["environment"] == "test-team, 2 copies"
    assert lines["agent_1"] == "observation 40, action 2, policy digest of agent_1"
    assert lines["steps"].startswith("1,200 (2,400 transitions per agent), begun 20")
    assert lines["episodes"].startswith(f"{len(episodes)}: ")
    assert lines["returns"].startswith(f"mean {returns.mean():,.2f}, std {returns.std():,.2f}")
    assert lines["gaps"] == "none"
    assert f"mujoco {made.header.versions['mujoco']}" in lines["versions"]


def test_a_part_is_told_by_steps_episode_and_agent(
    recorded: tuple[Recording, Path], replay
) -> None:
    made, path = recorded
    _, output = replay(path, "--steps", "100:200", "--agent", "agent_1")
    expected = sum(float(step.rewards[1].sum(dtype=np.float64)) for step in made.steps[100:200])
    assert "100 to 199: 100" in output and f"sum of rewards {expected:,.2f}" in output
    assert "agent_0" not in output

    episodes = read_summary(path).episodes
    number = next(i for i, episode in enumerate(episodes) if episode.copy and episode.start > 9)
    episode = episodes[number]
    _, output = replay(path, "--episode", number)
    assert f"episode       {number}, copy {episode.copy}, seed {episode.seed}" in output
    assert f"steps         {episode.start} to {episode.start + episode.length - 1}" in output
    for agent in (0, 1):
        assert f"sum of rewards {episode.returns[agent]:,.2f}" in output


def _bytes_read(what: Callable[[], object]) -> int:
    """As the system counts them."""

    def count() -> int:
        lines = Path("/proc/self/io").read_text().splitlines()
        return int(lines[0].removeprefix("rchar: "))

    before = count()
    overhead = count() - before
    before = count()
    what()
    return count() - before - overhead


def test_a_part_is_found_by_the_index(recorded: tuple[Recording, Path], replay) -> None:
    _, path = recorded
    size = path.stat().st_size
    assert _bytes_read(lambda: list(read_steps(path))) > size / 2
    assert _bytes_read(lambda: replay(path)) < size / 10
    for where in ("0:5", "600:605", "1190:"):
        assert _bytes_read(lambda where=where: replay(path, "--steps", where)) < size / 4
    assert _bytes_read(lambda: replay(path, "--episode", 200)) < size / 4


def test_an_unfinished_log_is_summarised_from_its_steps(tmp_path: Path, replay) -> None:
    made = Recording(((3, 1), (2, 2)), copies=2, steps=12)
    whole = made.finish(tmp_path / "whole.mcap")
    made.write(tmp_path / "log.mcap").close()
    for name in ("log.mcap", "log.mcap.partial"):  # the run's name for it, and the file's
        _, output = replay(tmp_path / name)
        assert "unfinished" in output and "12 (24 transitions" in output
    unfinished = read_summary(partial_path(tmp_path / "log.mcap"))
    assert unfinished.episodes == read_summary(whole).episodes
    assert unfinished.policies == {} and unfinished.extent.ranges == [(0, 12)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--steps", "1200:"), "no steps 1200: to show; it ends with step 1199"),
        (("--episode", "100000"), "no episode 100000; it has"),
        (("--agent", "agent_7"), "no agent 'agent_7'; it has agent_0, agent_1"),
    ],
)
def test_what_is_not_there_is_told_in_one_line(
    recorded: tuple[Recording, Path], refused, arguments: tuple[str, ...], said: str
) -> None:
    assert said in refused(recorded[1], *arguments)


@pytest.mark.parametrize("text", ["7", "9:3", "a:b", "-1:2"])
def test_a_range_that_is_none_is_told_in_one_line(
    recorded: tuple[Recording, Path], refused, text: str
) -> None:
    assert f"{text!r} is not a range of steps" in refused(recorded[1], f"--steps={text}")


def test_another_format_or_flag_is_told_in_one_line(
    recorded: tuple[Recording, Path], refused
) -> None:
    assert "invalid choice: 'hdf'" in refused(recorded[1], "--export", "hdf")
    assert "unknown flag '--steeps'" in refused(recorded[1], "--steeps", "1:2")
