"""Navigation: its beta in the data and over the deployments, its reward and its end."""

import numpy as np
import pytest

from otc_dist.datasets.generate import generate
from otc_dist.envs import registry


def _betas(progress, copies=4000):
    env = registry.make("navigation", copies, progress)
    env.reset(np.arange(copies), np.arange(copies))
    return env.state()[:, -1]


def _step(progress, action, start):
    env = registry.make("navigation", 1, progress)
    env.reset(np.array([0]), np.array([0]))
    state = env.state()
    state[0, 1:3] = start
    env.set_state(state)
    outcome = env.step([np.array([action], np.float32)])
    return env.observe()[0][0], outcome


def test_beta_is_uniform_over_the_datas_episodes():
    betas = _betas(None)
    assert np.abs(betas).max() <= 0.2
    counts, _ = np.histogram(betas, bins=8, range=(-0.2, 0.2))
    assert (np.abs(counts - 500) < 5 * np.sqrt(500)).all()


@pytest.mark.parametrize(("progress", "beta"), [(0.0, 0.1), (0.25, 0.125), (1.0, 0.2)])
def test_beta_moves_from_a_tenth_to_a_fifth_over_the_deployments(progress, beta):
    np.testing.assert_allclose(_betas(progress, 5), beta, rtol=1e-6)
    reached, _ = _step(progress, (1.0, -0.5), (0.5, 0.5))
    np.testing.assert_allclose(reached, (0.5 + beta, 0.5 - beta / 2), rtol=1e-6)


def test_the_deployments_start_where_the_data_could():
    offline, online = (registry.make("navigation", 3, progress) for progress in (None, 0.5))
    for env in (offline, online):
        env.reset(np.arange(3), np.arange(3))
    np.testing.assert_array_equal(offline.observe()[0], online.observe()[0])


def test_beta_stays_for_an_episode_and_is_not_observed():
    env, rng = registry.make("navigation", 50), np.random.default_rng(0)
    env.reset(np.arange(50), np.arange(50))
    betas = env.state()[:, -1]
    for _ in range(25):
        env.step([rng.uniform(-1, 1, (50, 2)).astype(np.float32)])
        np.testing.assert_array_equal(env.state()[:, -1], betas)
    assert env.observe()[0].shape == (50, 2)


@pytest.mark.parametrize(
    ("start", "reward"), [((-0.15, 0.0), 10.0), ((-0.1, 0.09), 10.0), ((-0.21, 0.0), 0.0)]
)
def test_reaching_the_landmark_brings_ten_and_ends_the_episode(start, reward):
    _, outcome = _step(0.0, (1.0, 0.0), start)
    assert outcome.rewards[0].tolist() == [reward]
    assert outcome.terminated.tolist() == [reward > 0]
    assert outcome.truncated.tolist() == [False]


def test_in_the_data_an_action_moves_as_far_one_way_as_the_other():
    """Why offline learning must fail: the mean movement of every action is 0."""
    data = generate("navigation", "random", 50_000)
    moved = data.next_observations[0] - data.observations[0]
    inside = np.abs(data.next_observations[0]).max(axis=1) < 1  # not stopped by a wall
    along = (moved * data.actions[0]).sum(axis=1)[inside]
    episodes = len(np.unique(data.episodes))
    # Signs and sizes of beta differ between episodes, so the mean's error falls with their number.
    assert abs(along.mean()) < 4 * np.abs(along).mean() / np.sqrt(episodes)
    one_way = np.abs(along).mean()
    assert one_way > 0.02
    assert 0 < data.terminated.mean() < 0.01  # but the landmark is found
    np.testing.assert_array_equal(data.rewards[0], 10.0 * data.terminated)
