"""What was exported can be imported again, as it was, or is refused."""

import json
from dataclasses import fields
from pathlib import Path

import h5py
import numpy as np
import pytest

from otc_dist.datasets import store
from otc_dist.datasets.importers import import_files
from otc_dist.datasets.joint import JointTransitions
from otc_dist.description import user_code
from otc_dist.terminal.errors import UserError

from .conftest import Replay
from .played import play
from .recorded import Deployments

JOINT = [("minari", "joint-v0"), ("vault", "joint.vlt"), ("lerobot", "joint")]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of each test's own, into which it imports."""
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "cache"))


def test_what_is_exported_as_d4rl_or_minari_can_be_imported_again(
    replay: Replay, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    alone = Deployments([path], [play("hopper-1x3", path, 120)])
    expected = alone.of_agent(0)
    for form, place in (("d4rl", "agent_0.hdf5"), ("minari", "agent_0-v0")):
        replay(path, "--export", form, "--out", tmp_path / form)
        import_files([tmp_path / form / place], form, "hopper-1x3")
        joint = store.load_joint(f"hopper-1x3/{form}")
        for name in ("observations", "actions", "rewards", "next_observations"):
            assert getattr(joint, name)[0].tobytes() == expected[name].tobytes()
        assert joint.terminated.tolist() == expected["terminated"].tolist()


def rows(data: JointTransitions) -> list[bytes]:
    """The transitions of a team, each with all that belongs to it, in any order."""
    shared = (data.terminated, data.truncated)
    numbers = (data.observations, data.actions, data.rewards, data.next_observations, shared)
    columns = [column.reshape(len(data), -1) for part in numbers for column in part]
    return sorted(row.tobytes() for row in np.concatenate(columns, axis=1))


@pytest.mark.parametrize(("form", "place"), JOINT)
@pytest.mark.parametrize("env_id", ["hopper-3x1", "5m_vs_6m", "simple"])
def test_a_joint_set_is_imported_like_the_logs_it_was_made_of(
    replay: Replay,
    tmp_path: Path,
    env_id: str,
    form: str,
    place: str,
) -> None:
    env_id = "mpe2.simple_push_v3:parallel_env" if env_id == "simple" else env_id
    user_code.allow(env_id)
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for deployment, path in enumerate(paths, 1):
        play(env_id, path, 40, run="a", deployment=deployment)
    replay(*paths, "--export", form, "--out", tmp_path / "out")
    logged = import_files(paths, "logged")
    back = import_files([tmp_path / "out" / place], "back")
    assert logged.returns is not None and back.returns == logged.returns
    assert (back.episodes, back.incomplete_episodes, back.terminated, back.truncated) == (
        logged.episodes,
        logged.incomplete_episodes,
        logged.terminated,
        logged.truncated,
    )
    assert rows(store.load_joint(f"{env_id}/back")) == rows(store.load_joint(f"{env_id}/logged"))


@pytest.mark.parametrize(
    ("form", "place", "env_id"),
    [
        ("vault", "joint.vlt", "hopper-3x1"),
        ("vault", "joint.vlt", "5m_vs_6m"),
        ("lerobot", "joint", "hopper-3x1"),
        ("minari", "joint-v0", "hopper-3x1"),
    ],
)
def test_a_data_set_goes_out_and_comes_back_to_the_bit(
    replay: Replay,
    tmp_path: Path,
    env_id: str,
    form: str,
    place: str,
) -> None:
    made = store.ensure(f"{env_id}/random", 150)
    _, told = replay(f"{env_id}/random", "--export", form, "--out", tmp_path / "out")
    assert "150 transitions" in told
    card = json.loads((tmp_path / "out" / "export.json").read_text())
    assert card["data_set"] == [json.loads(made.to_json())]
    back = import_files([tmp_path / "out" / place], "back")
    assert (back.returns, back.incomplete_episodes) == (made.returns, made.incomplete_episodes)
    before, after = store.load_joint(f"{env_id}/random", 150), store.load_joint(f"{env_id}/back")
    for field in fields(before):
        for one, other in zip(getattr(before, field.name), getattr(after, field.name), strict=True):
            assert np.asarray(one).tobytes() == np.asarray(other).tobytes(), field.name


@pytest.mark.parametrize(("form", "place"), JOINT)
def test_episodes_whose_beginning_was_not_exported_count_as_cut(
    hopper: Deployments,
    replay: Replay,
    tmp_path: Path,
    form: str,
    place: str,
) -> None:
    replay(hopper.paths[0], "--export", form, "--out", tmp_path / "out", "--steps", "9:100")
    card = import_files([tmp_path / "out" / place], "part")
    part = Deployments(hopper.paths[:1], [hopper.steps[0][9:100]]).trajectories()
    returns = [
        float(np.sum([step.rewards[0][copy] for _, copy, step in steps], dtype=np.float64))
        for steps in part
        if steps[0][2].step > 9 and steps[-1][2].terminated[steps[-1][1]]
    ]
    assert 0 < len(returns) < len(part) - 2 and card.returns is not None
    assert card.returns.mean == pytest.approx(np.mean(returns))
    assert (card.episodes, card.incomplete_episodes) == (len(returns), len(part) - len(returns))


def test_a_step_that_did_not_happen_is_left_out_of_a_joint_minari_set(
    hopper: Deployments, replay: Replay, tmp_path: Path
) -> None:
    replay(hopper.paths[0], "--export", "minari", "--out", tmp_path / "out", "--steps", "0:60")
    place = tmp_path / "out" / "joint-v0"
    whole = import_files([place], "whole")
    with h5py.File(place / "data" / "main_data.hdf5", "r+") as file:
        assert file["episode_0/terminations"][-1] and whole.returns is not None
        file["episode_0/truncations"][-1] = True
    card = import_files([place], "broken")
    assert card.transitions == whole.transitions - 1
    assert card.episodes == whole.episodes - 1
    assert "without 1 steps whose simulator broke off" in card.notes


def test_a_joint_minari_set_of_another_team_or_damaged_is_refused_in_one_line(
    hopper: Deployments, replay: Replay, tmp_path: Path
) -> None:
    replay(hopper.paths[0], "--export", "minari", "--out", tmp_path / "out", "--steps", "0:20")
    place = tmp_path / "out" / "joint-v0"

    def refusal(env_id: str = "") -> str:
        with pytest.raises(UserError) as raised:
            import_files([place], "mine", env_id)
        assert "\n" not in str(raised.value)
        return str(raised.value)

    assert "but the agents of walker2d-2x3 are agent_0, agent_1" in refusal("walker2d-2x3")
    assert "actions/agent_0 has shape (20, 1), not (any, 2)" in refusal("predator-prey-3")
    for field, said in (
        ("actions/agent_1", "has actions of agent_0, agent_2, but the agents of hopper-3x1 are"),
        ("infos/rewards/agent_2", "has no array infos/rewards/agent_2"),
        ("truncations", "has no array truncations"),
    ):
        replay(
            hopper.paths[0],
            *("--export", "minari", "--out", tmp_path / "out", "--steps", "0:20", "--force"),
        )
        with h5py.File(place / "data" / "main_data.hdf5", "r+") as file:
            del file[f"episode_0/{field}"]
        assert said in refusal()
