"""The skirmish's data: whose they are, and that they are what the environment does."""

import hashlib

import numpy as np
import pytest
from safetensors.numpy import load

from otc_dist.datasets import generate as generation
from otc_dist.datasets.behaviour import load_card, load_policy, snapshot_folder
from otc_dist.datasets.behaviour_training.training import TASKS, evaluate
from otc_dist.datasets.generate import generate
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.random_source import RandomSource
from otc_dist.envs import registry
from otc_dist.randomness import derive_seed
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import choice_problem

NAME = "5m_vs_6m"


@pytest.fixture(scope="module")
def data():
    return generate(NAME, "medium", 1500, seed=3)


def test_they_are_a_function_of_their_arguments(data, monkeypatch):
    monkeypatch.setattr(generation, "_MAX_COPIES", 3)
    again = generate(NAME, "medium", 1000, seed=3)
    for field in ("observations", "actions", "rewards", "next_observations"):
        for ours, theirs in zip(getattr(again, field), getattr(data, field), strict=True):
            np.testing.assert_array_equal(ours, theirs[:1000])
    other = generate(NAME, "medium", 1000, seed=4)
    assert not np.array_equal(other.actions[0], again.actions[0])


def test_every_action_was_available_and_the_dead_took_the_no_op(data):
    for agent, spec in enumerate(registry.team_spec(NAME).agents):
        assert choice_problem(data.of_agent(agent), spec.choices) is None
        dead = data.observations[agent][:, 55] == 1
        assert 0 < dead.sum() < len(data) / 2
        np.testing.assert_array_equal(data.actions[agent][dead], 0)


def test_rows_are_the_environments_own_transitions(data):
    env = registry.make(NAME, 1)
    for episode in range(5):
        env.reset(np.array([0]), np.array([derive_seed(3, NAME, "medium", "medium", episode)]))
        for row in np.flatnonzero(data.episodes == episode):
            for agent, seen in enumerate(env.observe()):
                np.testing.assert_array_equal(seen[0], data.observations[agent][row])
            outcome = env.step([action[row : row + 1] for action in data.actions])
            assert outcome.rewards[4][0] == data.rewards[4][row]
            assert outcome.terminated[0] == data.terminated[row]
            for agent, seen in enumerate(env.observe()):
                np.testing.assert_array_equal(seen[0], data.next_observations[agent][row])


def test_the_policy_is_the_one_that_its_card_describes():
    medium = load_card(NAME).medium
    content = snapshot_folder(NAME).joinpath(medium.file).read_bytes()
    assert hashlib.sha256(content).hexdigest() == medium.sha256
    assert abs(medium.success - TASKS[NAME].medium) < 5


def test_the_policy_is_nearly_deterministic(data):
    policy = load_policy(NAME, load_card(NAME).medium)
    greedy = []
    for seen, actions in zip(data.observations, data.actions, strict=True):
        alive = seen[:, 55] == 0
        chosen = policy.act(seen[alive], np.zeros((int(alive.sum()), 12), np.float32))
        greedy.append((chosen == actions[alive]).mean())
    assert np.mean(greedy) > 0.9


def test_random_actions_are_uniform_among_what_is_available():
    data = generate(NAME, "random", 4000)
    observations, actions = np.concatenate(data.observations), np.concatenate(data.actions)
    mask = observations[:, 55:] > 0
    shares = np.zeros(12)
    for action in range(12):
        expected = (mask[:, action] / mask.sum(axis=1)).sum()
        shares[action] = (actions[:, 0] == action).sum() / expected
    np.testing.assert_allclose(shares, 1, atol=0.12)
    assert all(choice_problem(data.of_agent(i), 12) is None for i in range(5))


def test_names_of_adapted_maps_keep_their_slash():
    name = DatasetName.parse("smax/5m_vs_6m/random")
    assert (name.env_id, name.level) == ("smax/5m_vs_6m", "random")


@pytest.mark.parametrize("env_id", ["smac/5m_vs_6m", "smax/5m_vs_6m", "my_module:parallel_env"])
def test_of_adapted_environments_only_random_data_are_made(env_id):
    assert DatasetName.parse(f"{env_id}/random").usual_size() > 0
    with pytest.raises(UserError) as raised:
        DatasetName.parse(f"{env_id}/medium")
    assert str(raised.value) == (
        f"there is no data set {env_id}/medium: of {env_id} only random can be made; other data"
        " can be imported, see python -m otc_dist.datasets import --help"
    )


def test_the_usual_size_is_known():
    assert DatasetName.parse(f"{NAME}/medium").usual_size() == 234_224
    assert DatasetName.parse("smac/3m/random").usual_size() == 100_000
    assert DatasetName.parse("smax/3m/random").usual_size() == 234_224


def test_smax_s_random_data_keep_their_seeds():
    """They were made by a policy of this name, on which the episodes' seeds depend."""
    assert RandomSource().policies("smax/3m", "random") == ("random",)
    assert RandomSource().policies("smac/3m", "random") == ("uniform",)


@pytest.mark.slow
def test_the_policy_wins_about_half_of_its_battles():
    content = snapshot_folder(NAME).joinpath(load_card(NAME).medium.file).read_bytes()
    assert 40 < evaluate(NAME, load(content), 1, "test").level < 60
