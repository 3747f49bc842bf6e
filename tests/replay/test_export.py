"""Exports hold what was logged, to the bit, in the words of each format."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from otc_dist.datasets import store
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.record import Rows
from otc_dist.replay.export.formats import FORMATS
from otc_dist.replay.export.trajectories import trajectories
from otc_dist.replay.selection import Selection
from tests.deployment_log.conftest import Recording

from .conftest import Replay
from .exported import READERS, column, minari_episodes, read_parquet
from .played import play
from .recorded import Arrays, Deployments

AGENTS = ("agent_0", "agent_1", "agent_2")


def same_bits(found: Arrays, expected: Arrays) -> None:
    for name in set(found) & set(expected):
        wanted = expected[name].astype(found[name].dtype)
        assert found[name].shape == wanted.shape, name
        assert found[name].tobytes() == wanted.tobytes(), name
    assert set(expected) - {"truncated", "exploring", "log", "copy", "step"} <= set(found)


@pytest.mark.parametrize("form", list(FORMATS))
def test_each_agent_gets_its_own_transitions_to_the_bit(
    hopper: Deployments, replay: Replay, tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("otc_dist.replay.export.command._BATCH", 250)
    out = tmp_path / "out"
    status, output = replay(*hopper.paths, "--export", form, "--out", out)
    assert status == 0 and "600 transitions" in output
    for index, agent in enumerate(AGENTS):
        same_bits(READERS[form](out, agent), hopper.of_agent(index))
    card = json.loads((out / "export.json").read_text())
    assert card["transitions"] == 600
    assert card["trajectories"] == len(hopper.trajectories())
    assert [log["file"] for log in card["logs"]] == [path.name for path in hopper.paths]
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.parametrize("form", list(FORMATS))
def test_discrete_actions_are_kept_as_their_indices(
    replay: Replay, tmp_path: Path, form: str
) -> None:
    battle = Deployments([tmp_path / "a.mcap"], [play("5m_vs_6m", tmp_path / "a.mcap", 40, 1)])
    replay(*battle.paths, "--export", form, "--out", tmp_path / "out", "--agent", "agent_3")
    same_bits(READERS[form](tmp_path / "out", "agent_3"), battle.of_agent(3))
    names = {path.name for path in (tmp_path / "out").iterdir()} - {"export.json"}
    assert len(names) == 1  # nothing of the others, and no joint set


def test_the_joint_sets_hold_all_agents_and_the_state(
    hopper: Deployments, replay: Replay, tmp_path: Path
) -> None:
    for form in ("parquet", "lerobot", "minari"):
        replay(*hopper.paths, "--export", form, "--out", tmp_path / form)
    agents = [hopper.of_agent(index) for index in range(3)]
    rows = [row for part in hopper.trajectories() for row in part]

    table = pq.read_table(tmp_path / "parquet" / "joint.parquet")
    for agent, expected in zip(AGENTS, agents, strict=True):
        for name in ("observation", "action", "reward", "next_observation"):
            found = column(table, f"{agent}.{name}")
            assert found.tobytes() == expected[f"{name}s"].tobytes()
    state = np.array([step.state[copy] for _, copy, step in rows])
    assert column(table, "state").tobytes() == state.tobytes()
    seeds = [int(step.episode_seeds[copy]) for _, copy, step in rows]
    assert column(table, "episode_seed").tolist() == seeds

    frames = pq.read_table(tmp_path / "lerobot" / "joint" / "data")
    actions = np.concatenate([expected["actions"] for expected in agents], axis=1)
    assert column(frames, "action").tobytes() == actions.tobytes()
    assert column(frames, "next.reward").shape == (600, 3)

    episodes = minari_episodes(tmp_path / "minari", "joint")
    for agent, expected in zip(AGENTS, agents, strict=True):
        taken = np.concatenate([episode.actions[agent] for episode in episodes])
        own = np.concatenate([episode.infos["rewards"][agent] for episode in episodes])
        assert taken.tobytes() == expected["actions"].tobytes()
        assert own.tobytes() == expected["rewards"].tobytes()
    team = np.concatenate([episode.rewards for episode in episodes])
    assert (team == agents[0]["rewards"]).all()  # all hoppers have the same reward


def test_minari_sets_are_found_by_their_names(
    hopper: Deployments, replay: Replay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import minari

    monkeypatch.chdir(tmp_path)
    replay(*hopper.paths, "--export", "minari", "--out", "out")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "out"))
    data = minari.load_dataset("agent_1-v0")
    assert (data.total_steps, data.action_space.shape) == (600, (1,))
    assert set(minari.list_local_datasets()) == {
        "agent_0-v0",
        "agent_1-v0",
        "agent_2-v0",
        "joint-v0",
    }


def test_a_data_set_that_cannot_be_exported_is_refused_in_one_line(
    refused: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))
    out = ("--export", "csv", "--out", tmp_path / "out")
    assert "is not in the cache" in refused("hopper-3x1/random", *out)
    assert "unknown data set" in refused("hopper-3x1/rndom", *out)
    store.ensure("hopper-3x1/random", 5)
    assert "--steps is for logs" in refused("hopper-3x1/random", *out, "--steps", "1:2")
    assert "has no agent 'x'" in refused("hopper-3x1/random", *out, "--agent", "x")
    other = ("--transitions", "6")
    assert "with 6 transitions is not in the cache" in refused("hopper-3x1/random", *out, *other)
    assert not (tmp_path / "out").exists()


def test_a_part_of_a_log_is_exported(hopper: Deployments, replay: Replay, tmp_path: Path) -> None:
    some = Deployments(hopper.paths[:1], [hopper.steps[0][40:90]])
    replay(*some.paths, "--export", "parquet", "--out", tmp_path / "a", "--steps", "40:90")
    same_bits(read_parquet(tmp_path / "a", "agent_1"), some.of_agent(1))
    replay(*some.paths, "--export", "parquet", "--out", tmp_path / "b", "--episode", 1)
    found = read_parquet(tmp_path / "b", "agent_1")
    assert found["starts"].tolist() == [0] and set(found["copy"].tolist()) == {1}


def test_any_bits_survive_and_many_blocks_and_an_unfinished_log(
    replay: Replay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NaN, infinities, negative zero; more data than are read or written at once."""
    monkeypatch.setattr("otc_dist.replay.export.command._BATCH", 300)
    made = Recording(((50, 3), (40, 2)), copies=2, steps=900)
    made.write(tmp_path / "log.mcap").close()
    whole = Deployments([tmp_path / "log.mcap"], [made.steps])
    for form in ("parquet", "d4rl", "vault"):
        replay(*whole.paths, "--export", form, "--out", tmp_path / form)
        for index in (0, 1):
            found = READERS[form](tmp_path / form, f"agent_{index}")
            same_bits(found, whole.of_agent(index))


def test_minari_episodes_are_cut_where_the_next_observation_is_another(
    replay: Replay, tmp_path: Path
) -> None:
    made = Recording(((3, 1), (2, 2)), copies=1, steps=6)
    for t in range(6):
        ends = np.zeros(1, np.bool_)
        made.steps[t] = replace(made.steps[t], terminated=ends, truncated=ends)
        if t in (1, 2, 4):  # what follows steps 0, 1 and 3
            seen = made.steps[t - 1].next_observations
            made.steps[t] = replace(made.steps[t], observations=seen)
    made.finish(tmp_path / "log.mcap")
    replay(tmp_path / "log.mcap", "--export", "minari", "--out", tmp_path / "out")
    lengths = [len(episode) for episode in minari_episodes(tmp_path / "out", "agent_0")]
    assert lengths == [3, 2, 1]


class Gaps:
    """Stands for a log that lacks steps, which is read in small blocks."""

    def __init__(self, path: Path, missing: range) -> None:
        self._log, self._missing = OpenLog(path), missing
        self.header, self.layout = self._log.header, self._log.layout

    def blocks(self, start: int, stop: int) -> Sequence[Rows]:
        rows = np.concatenate(list(self._log.blocks(start, stop)))
        kept = rows[~np.isin(rows["step"], list(self._missing))]
        return [kept[first : first + 7] for first in range(0, len(kept), 7)]


@pytest.mark.parametrize("missing", [range(0), range(0, 5), range(20, 22), range(27, 29)])
def test_no_trajectory_goes_over_steps_that_are_missing(
    hopper: Deployments, missing: range
) -> None:
    log: Any = Gaps(hopper.paths[0], missing)
    found = list(trajectories(log, Selection(0, 150, AGENTS), 0))
    for part in found:
        steps = range(part.start, part.start + len(part))
        assert not set(steps) & set(missing)
        for row, t in enumerate(steps):
            step = hopper.steps[0][t]
            assert part.state[row].tobytes() == step.state[part.copy].tobytes()
            assert part.seed == step.episode_seeds[part.copy]
        ends = part.terminated | part.truncated
        assert not ends[:-1].any()
    assert sum(map(len, found)) == 2 * (150 - len(missing))
    whole = [part for part in hopper.trajectories() if part[0][0] == 0]
    assert len(found) <= len(whole) + 2
