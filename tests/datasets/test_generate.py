import hashlib
from dataclasses import fields

import numpy as np
import pytest

from otc_dist.datasets import generate as generation
from otc_dist.datasets.behaviour import load_card, load_policy, snapshot_folder
from otc_dist.datasets.generate import generate, parts
from otc_dist.datasets.robot_source import LEVELS
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError

ROBOTS = ("hopper", "halfcheetah", "walker2d")


def _arrays(data):
    for field in fields(data):
        value = getattr(data, field.name)
        yield from value if isinstance(value, tuple) else (value,)


def _assert_same(ours, theirs):
    for left, right in zip(_arrays(ours), _arrays(theirs), strict=True):
        np.testing.assert_array_equal(left, right, strict=True)


def _rows(data, count):
    """The first rows, without the ends (a cut marks its last row)."""
    for array in (*data.observations, *data.actions, *data.rewards, *data.next_observations):
        yield array[:count]
    yield data.episodes[:count]


@pytest.mark.parametrize("level", LEVELS)
def test_same_arguments_same_bytes(level):
    ours, theirs = (generate("hopper-3x1", level, 3000, seed=4) for _ in range(2))
    _assert_same(ours, theirs)
    other = generate("hopper-3x1", level, 3000, seed=5)
    assert not np.array_equal(ours.actions[0], other.actions[0])


@pytest.mark.parametrize("level", LEVELS)
def test_rows_do_not_depend_on_the_copies_that_play(level, monkeypatch):
    usual = generate("walker2d-2x3", level, 7001)
    monkeypatch.setattr(generation, "_MAX_COPIES", 3)
    _assert_same(usual, generate("walker2d-2x3", level, 7001))


def test_a_longer_set_begins_with_the_shorter_one():
    short, long = (generate("hopper-3x1", "medium", count) for count in (1500, 4000))
    for ours, theirs in zip(_rows(short, 1500), _rows(long, 1500), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("env_id", ["hopper-3x1", "halfcheetah-2x3"])
def test_shapes_order_and_ends(env_id, level):
    spec, data = registry.team_spec(env_id), generate(env_id, level, 2501)
    for index, agent in enumerate(spec.agents):
        assert data.observations[index].shape == (2501, agent.observation_size)
        assert data.next_observations[index].shape == (2501, agent.observation_size)
        assert data.actions[index].shape == (2501, agent.action_size)
        assert np.abs(data.actions[index]).max() <= 1.0
        assert data.rewards[index].shape == (2501,)
    assert all(np.isfinite(array).all() for array in _arrays(data))
    changes = np.diff(data.episodes)
    assert set(changes.tolist()) <= {0, 1}
    ended = data.terminated | data.truncated
    assert not (data.terminated & data.truncated).any()
    np.testing.assert_array_equal(ended, np.append(changes == 1, True))
    # Within an episode s' is the next row's s; at its end it is not the next episode's.
    follows = (data.next_observations[0][:-1] == data.observations[0][1:]).all(axis=1)
    np.testing.assert_array_equal(follows, ~ended[:-1])


def test_rows_are_true_transitions():
    """Played again from an episode's own seed, the actions give the same rewards and s'."""
    data = generate("hopper-3x1", "random", 400, seed=9)
    env = registry.make("hopper-3x1", 1)
    rows = np.arange(400)
    for episode in range(3):
        seed = generation.derive_seed(9, "hopper", "random", "uniform", episode)
        env.reset(np.array([0]), np.array([seed]))
        for row in rows[data.episodes == episode]:
            np.testing.assert_array_equal(env.observe()[0][0], data.observations[0][row])
            outcome = env.step([action[row : row + 1] for action in data.actions])
            np.testing.assert_array_equal(env.observe()[0][0], data.next_observations[0][row])
            assert outcome.rewards[0][0] == data.rewards[0][row]
            assert outcome.terminated[0] == data.terminated[row]


def test_partitions_of_a_robot_share_its_data():
    split, whole = (generate(env_id, "medium", 1000) for env_id in ("hopper-3x1", "hopper-1x3"))
    np.testing.assert_array_equal(np.concatenate(split.actions, axis=1), whole.actions[0])
    np.testing.assert_array_equal(split.observations[2], whole.observations[0])


@pytest.mark.parametrize("robot", ROBOTS)
def test_medium_replay_has_equal_shares_in_training_order(robot):
    env_id = {"hopper": "hopper-3x1"}.get(robot, f"{robot}-2x3")
    shares = parts(env_id, "medium-replay", 1003)
    assert [share.policy for share in shares] == [
        snapshot.file.removesuffix(".safetensors") for snapshot in load_card(robot).snapshots
    ]
    assert shares[0].start == 0
    assert shares[-1].stop == 1003
    sizes = [share.stop - share.start for share in shares]
    assert max(sizes) - min(sizes) <= 1
    (medium,) = parts(env_id, "medium", 1003)
    assert medium.policy == shares[-1].policy


def test_progress_ends_at_the_whole():
    calls = []
    generate("hopper-3x1", "random", 5000, report=lambda *now: calls.append(now))
    assert calls[-1] == (5000, 5000)
    assert calls == sorted(calls)


def test_what_is_refused():
    with pytest.raises(UserError, match="did you mean 'hopper-3x1'"):
        generate("hopper-3x", "random", 10)
    with pytest.raises(UserError, match="did you mean 'medium'"):
        generate("hopper-3x1", "medum", 10)
    with pytest.raises(UserError, match="at least"):
        generate("hopper-3x1", "random", 0)


@pytest.mark.parametrize("robot", ROBOTS)
def test_snapshots_are_those_of_the_card(robot):
    card, folder = load_card(robot), snapshot_folder(robot)
    files = {item.name for item in folder.iterdir()} - {"card.json"}
    assert files == {snapshot.file for snapshot in card.snapshots}
    for snapshot in card.snapshots:
        data = folder.joinpath(snapshot.file).read_bytes()
        assert hashlib.sha256(data).hexdigest() == snapshot.sha256
        assert snapshot.episodes >= 20
    assert [snapshot.steps for snapshot in card.snapshots] == sorted(
        {snapshot.steps for snapshot in card.snapshots}
    )


@pytest.mark.parametrize("robot", ROBOTS)
def test_an_action_does_not_depend_on_the_batch(robot):
    policy, rng = load_policy(robot, load_card(robot).medium), np.random.default_rng(0)
    sizes = registry.team_spec("hopper-1x3" if robot == "hopper" else f"{robot}-1x6").agents[0]
    observations = rng.standard_normal((129, sizes.observation_size), np.float32)
    noise = rng.standard_normal((129, sizes.action_size), np.float32)
    together = policy.act(observations, noise)
    for size in (1, 2, 7, 64):
        np.testing.assert_array_equal(
            policy.act(observations[:size], noise[:size]), together[:size]
        )


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_medium_data_score_as_the_card_says(robot):
    env_id = "hopper-3x1" if robot == "hopper" else f"{robot}-2x3"
    data, medium = generate(env_id, "medium", 60_000), load_card(robot).medium
    returns = np.bincount(data.episodes, weights=data.rewards[0])[:-1]  # without the cut episode
    error = 3 * medium.return_std * np.sqrt(1 / len(returns) + 1 / medium.episodes)
    assert returns.mean() == pytest.approx(medium.return_mean, abs=error)
