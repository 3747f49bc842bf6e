"""Recordings in D4RL's layout become agents' files whose successors are the true ones."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from otc_dist.datasets import store
from otc_dist.datasets.importers import import_file, import_files
from otc_dist.system.extras import install
from otc_dist.terminal.errors import UserError

from .recordings import Played, play, refusal, write_d4rl

pytestmark = pytest.mark.usefixtures("cache")
NAME = "hopper-3x1/mine"
NO_SUCCESSORS = "next_observations infos/qpos infos/qvel"


def test_a_d4rl_file_with_successors_is_kept_whole(file: Path, played: Played) -> None:
    card = import_file(write_d4rl(file, played), "mine")
    assert (card.name, card.transitions, card.notes) == (NAME, 301, ())
    assert (card.terminated, card.truncated) == (played.terminals.sum(), played.timeouts.sum())
    # Whatever cut the others below the task's limit of 1,000 steps, it was not the task.
    assert (card.episodes, card.incomplete_episodes) == (
        played.terminals.sum(),
        played.timeouts.sum() + 1,
    )
    joint = store.load_joint(NAME)
    for agent in range(3):
        np.testing.assert_array_equal(joint.observations[agent], played.observations)
        np.testing.assert_array_equal(joint.actions[agent][:, 0], played.actions[:, agent])
        np.testing.assert_array_equal(joint.rewards[agent], played.rewards)
        np.testing.assert_array_equal(joint.next_observations[agent], played.successors)
    assert store.usual_size(NAME) == 301
    assert store.ensure(NAME) == card


def test_two_agents_get_three_actuators_each(tmp_path: Path) -> None:
    played = play("walker2d-1x6", 60)
    import_file(write_d4rl(tmp_path / "walker2d_random-v2.hdf5", played), "mine")
    joint = store.load_joint("walker2d-2x3/mine")
    np.testing.assert_array_equal(np.hstack(joint.actions), played.actions)
    assert [part.shape[1] for part in joint.actions] == [3, 3]


def test_one_agent_can_have_it_all(file: Path, played: Played) -> None:
    card = import_file(write_d4rl(file, played), "mine", "hopper-1x3")
    assert list(card.files) == ["agent_0"]
    np.testing.assert_array_equal(store.load_joint("hopper-1x3/mine").actions[0], played.actions)


def test_without_successors_no_transition_crosses_an_end(file: Path, played: Played) -> None:
    card = import_file(write_d4rl(file, played, leave_out=NO_SUCCESSORS), "mine")
    lost = np.append(played.ends, 300)
    kept = np.delete(np.arange(301), lost)
    assert card.transitions == len(kept)
    assert card.notes == (
        f"{len(lost)} transitions were dropped: the file lacks their true successor; "
        f"{played.terminals.sum()} of them terminated, 0 that terminated are left, "
        "so learners cannot see that falling ends an episode",
    )
    joint = store.load_joint(NAME)
    np.testing.assert_array_equal(joint.next_observations[0], played.successors[kept])
    np.testing.assert_array_equal(joint.actions[2][:, 0], played.actions[kept, 2])


def test_dropping_does_not_change_the_returns(tmp_path: Path, played: Played) -> None:
    whole = import_file(write_d4rl(tmp_path / "hopper_a.hdf5", played), "whole")
    cut = import_file(
        write_d4rl(tmp_path / "hopper_b.hdf5", played, leave_out=NO_SUCCESSORS), "cut"
    )
    assert cut.transitions < whole.transitions
    assert (cut.returns, cut.episodes) == (whole.returns, whole.episodes)


def test_successors_that_were_joined_across_resets_are_not_believed(
    file: Path, played: Played
) -> None:
    joined = np.roll(played.observations, -1, axis=0)
    leave_out = "infos/qpos infos/qvel"
    write_d4rl(file, played, leave_out=leave_out, next_observations=joined)
    import_file(file, "mine")
    kept = np.delete(np.arange(301), [*played.ends, 300])
    found = store.load_joint(NAME).next_observations[0]
    np.testing.assert_array_equal(found, played.successors[kept])


def test_lacking_successors_are_simulated_from_the_states(file: Path, played: Played) -> None:
    card = import_file(write_d4rl(file, played, leave_out="next_observations"), "mine")
    assert card.transitions == 301
    assert card.terminated == played.terminals.sum()
    assert card.notes[0].startswith(f"{len(played.ends) + 1} successors were simulated")
    found = store.load_joint(NAME).next_observations[0]
    np.testing.assert_allclose(found, played.successors, atol=1e-3)


def test_states_that_do_not_reproduce_the_data_are_not_simulated(
    file: Path, played: Played
) -> None:
    elsewhere = {"infos/qvel": played.qvel + 1.0}
    write_d4rl(file, played, leave_out="next_observations", **elsewhere)
    card = import_file(file, "mine")
    assert card.transitions == 301 - len(played.ends) - 1
    assert "were not simulated" in card.notes[0]


def test_episodes_without_timeouts_are_cut_at_the_time_limit(tmp_path: Path) -> None:
    rows = 2500
    draw = np.random.default_rng(0)
    file = tmp_path / "halfcheetah_random-v0.hdf5"
    terminals = np.zeros(rows, np.bool_)
    terminals[299] = True
    played = Played(
        observations=draw.standard_normal((rows, 17)),
        actions=draw.uniform(-1, 1, (rows, 6)),
        rewards=np.ones(rows),
        successors=np.empty(0),
        terminals=terminals,
        timeouts=np.empty(0),
        qpos=np.empty(0),
        qvel=np.empty(0),
    )
    card = import_file(write_d4rl(file, played, leave_out=f"timeouts {NO_SUCCESSORS}"), "mine")
    # Ends at rows 299, 1299 and 2299, and a last row whose successor is not there.
    assert card.transitions == rows - 4
    assert (card.episodes, card.incomplete_episodes) == (3, 1)
    assert "cut at 1000 steps" in card.notes[0]


def test_actions_beyond_the_bounds_are_clipped_and_counted(file: Path, played: Played) -> None:
    actions = played.actions.copy()
    actions[[3, 8], 1] = (1.5, -2.0)
    card = import_file(write_d4rl(file, played, actions=actions), "mine")
    assert card.notes[0].startswith("2 actions beyond the bounds were clipped")
    assert store.load_joint(NAME).actions[1][[3, 8], 0].tolist() == [1.0, -1.0]


def test_the_same_file_twice_is_one_data_set_and_another_is_refused(
    file: Path, played: Played
) -> None:
    first = import_file(write_d4rl(file, played), "mine")
    assert import_file(file, "mine") == first
    write_d4rl(file, played, rewards=played.rewards + 1)
    assert "is there already" in refusal(file)


def test_a_damaged_import_is_refused_with_what_to_do(file: Path, played: Played) -> None:
    import_file(write_d4rl(file, played), "mine")
    store.agent_file(NAME, "agent_1").write_bytes(b"")
    with pytest.raises(UserError, match="import the data set again"):
        store.ensure(NAME)


def test_an_import_comes_in_one_size(file: Path, played: Played) -> None:
    import_file(write_d4rl(file, played), "mine")
    assert store.ensure(NAME, 301).transitions == 301
    with pytest.raises(UserError, match="imported with 301 transitions"):
        store.ensure(NAME, 100)


BAD: list[tuple[str, dict[str, Any], str]] = [
    ("terminals", {}, "no terminals in it"),
    ("observations actions", {}, "no observations, actions in it"),
    ("", {"observations": np.zeros((301, 17))}, "observations has shape (301, 17), not (any, 11)"),
    ("", {"actions": np.zeros((300, 3))}, "actions has shape (300, 3), not (301, 3)"),
    ("", {"rewards": np.full(301, np.nan)}, "rewards has a value that is not finite"),
    ("", {"rewards": np.full(301, 1e300)}, "rewards has a value that is not finite"),
    ("", {"terminals": np.full(301, 2)}, "terminals holds values other than 0 and 1"),
    ("", {"actions": np.full((301, 3), b"x")}, "actions holds |S1, not numbers"),
    ("", {"next_observations": np.zeros((301, 3))}, "next_observations has shape (301, 3)"),
    ("", {"observations": np.zeros((0, 11))}, "is empty"),
]


@pytest.mark.parametrize(("leave_out", "replaced", "message"), BAD)
def test_a_bad_d4rl_file_is_refused(
    file: Path, played: Played, leave_out: str, replaced: dict[str, Any], message: str
) -> None:
    assert message in refusal(write_d4rl(file, played, leave_out=leave_out, **replaced))
    with pytest.raises(UserError, match="unknown data set"):
        store.usual_size(NAME)


def test_what_is_no_hdf5_is_refused(file: Path, played: Played, tmp_path: Path) -> None:
    assert "no file" in refusal(file)
    file.write_text("hello")
    assert "cannot be read as HDF5" in refusal(file)
    content = write_d4rl(file, played).read_bytes()
    file.write_bytes(content[: len(content) // 2])
    assert "cannot be read as HDF5" in refusal(file)
    assert "no main_data.hdf5" in refusal(tmp_path)


def test_the_environment_is_guessed_or_asked_for(tmp_path: Path, played: Played) -> None:
    file = write_d4rl(tmp_path / "data.hdf5", played)
    assert "--env hopper-3x1" in refusal(file)
    assert import_file(file, "mine", "hopper-3x1").transitions == 301
    with pytest.raises(UserError, match="did you mean 'hopper-3x1'"):
        import_file(file, "mine", "hopper-3x")


@pytest.mark.parametrize("level", ["medium", "", "a/b", "..", ".hidden"])
def test_a_name_that_is_taken_or_no_name_is_refused(file: Path, played: Played, level: str) -> None:
    write_d4rl(file, played)
    assert "data set" in refusal(file, level)


def test_without_h5py_the_extra_is_named(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file.touch()
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "importing needs h5py" in refusal(file) and install("import") in refusal(file)


def test_one_agents_file_is_all_that_its_learners_host_needs(
    file: Path, played: Played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = import_file(write_d4rl(file, played), "mine")
    here = store.agent_file(made.name, "agent_1")
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path / "another"))
    card = import_files([here])
    assert card == import_files([here])
    assert (card.episodes, card.incomplete_episodes) == (made.episodes, made.incomplete_episodes)
    assert (card.name, card.transitions) == (made.name, made.transitions)
    assert card.files == {"agent_1": made.files["agent_1"]}
    assert store.ensure(made.name, agents=["agent_1"]) == card
    there = store.agent_file(made.name, "agent_1")
    assert there != here and there.read_bytes() == here.read_bytes()
    for level, env_id, flag in (("other", "", "--name"), ("", "hopper-3x1", "--env")):
        with pytest.raises(UserError, match=f"says which set it is of: leave out {flag}"):
            import_files([here], level, env_id)
    with pytest.raises(UserError, match=r"no file of agent_0: import agent_0\.safetensors"):
        store.ensure(made.name)
    import_files([here.with_name("agent_0.safetensors")])  # two may learn on one machine
    store.ensure(made.name, agents=["agent_0", "agent_1"])


def test_a_file_that_is_made_alike_everywhere_is_not_imported() -> None:
    store.ensure("hopper-3x1/random", 300)
    with pytest.raises(UserError, match="make hopper-3x1/random --transitions 300 --agent agent_2"):
        import_files([store.agent_file("hopper-3x1/random", "agent_2", 300)])
