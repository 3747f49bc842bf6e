"""Minari's data sets become agents' files whose successors are the true ones."""

from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest
from minari.data_collector import EpisodeBuffer

from otc_dist.datasets import store
from otc_dist.datasets.importers import import_file

from .recordings import Played, refusal, write_d4rl

pytestmark = pytest.mark.usefixtures("cache")


@pytest.fixture
def minari_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, played: Played) -> Path:
    """The recording as Minari itself writes it."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    buffers = []
    for number, rows in enumerate(np.split(np.arange(301), played.ends + 1)):
        buffers.append(
            EpisodeBuffer(
                id=number,
                observations=np.vstack((played.observations[rows], played.successors[rows[-1:]])),
                actions=played.actions[rows],
                rewards=played.rewards[rows].tolist(),
                terminations=played.terminals[rows].tolist(),
                truncations=played.timeouts[rows].tolist(),
                infos={},
            )
        )
    with pytest.warns(UserWarning):
        minari.create_dataset_from_buffers(
            "mujoco/hopper/test-v0",
            buffer=buffers,
            env=gymnasium.make("Hopper-v5"),
            algorithm_name="uniform",
            author="a",
            author_email="b",
            code_permalink="c",
            data_format="hdf5",
        )
    return tmp_path / "minari" / "mujoco" / "hopper" / "test-v0"


def test_a_minari_set_is_kept_whole_with_true_successors(
    minari_set: Path, played: Played, file: Path
) -> None:
    card = import_file(minari_set, "mine")
    assert (card.name, card.transitions) == ("hopper-3x1/mine", 301)
    assert card.returns == import_file(write_d4rl(file, played), "again").returns
    assert (card.episodes, card.incomplete_episodes) == (
        played.terminals.sum(),
        played.timeouts.sum() + 1,
    )
    assert card.notes == ("recorded in Hopper-v5",)
    joint = store.load_joint("hopper-3x1/mine")
    np.testing.assert_array_equal(joint.next_observations[2], played.successors)
    np.testing.assert_array_equal(joint.actions[1][:, 0], played.actions[:, 1])
    np.testing.assert_array_equal(joint.terminated, played.terminals)
    np.testing.assert_array_equal(joint.truncated, played.timeouts)


def test_a_minari_set_can_be_named_by_any_of_its_folders_or_its_file(minari_set: Path) -> None:
    cards = [
        import_file(source, "mine")
        for source in (minari_set, minari_set / "data", minari_set / "data" / "main_data.hdf5")
    ]
    assert cards[0] == cards[1] == cards[2]
    assert "is not a single Minari data set" in refusal(minari_set.parents[2])


def test_a_minari_set_of_another_robot_is_refused(minari_set: Path) -> None:
    message = refusal(minari_set, env_id="walker2d-2x3")
    assert "episode_0: actions has shape" in message
