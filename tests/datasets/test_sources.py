"""Data of any family of tasks: who plays, what agents see, and names of sets for any team."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from otc_dist.datasets import generate as generation
from otc_dist.datasets import store
from otc_dist.datasets.generate import generate
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.names import DatasetName, known_names
from otc_dist.datasets.random_source import RandomSource
from otc_dist.datasets.source import Uniform
from otc_dist.envs import registry
from otc_dist.envs.base import Outcome
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32

PARTICLES = ("predator-prey-3", "cooperative-navigation-2", "navigation")


def assert_same(ours: JointTransitions, theirs: JointTransitions) -> None:
    for name, value in vars(ours).items():
        np.testing.assert_array_equal(value, getattr(theirs, name), strict=True)


@pytest.mark.parametrize("env_id", PARTICLES)
def test_random_data_are_a_function_of_their_arguments(
    env_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = generate(env_id, "random", 3010, seed=4)
    assert_same(usual, generate(env_id, "random", 3010, seed=4))
    assert not np.array_equal(usual.actions[0], generate(env_id, "random", 3010, seed=5).actions[0])
    longer = generate(env_id, "random", 4000, seed=4)
    np.testing.assert_array_equal(longer.observations[0][:3010], usual.observations[0])
    monkeypatch.setattr(generation, "_MAX_COPIES", 7)
    assert_same(usual, generate(env_id, "random", 3010, seed=4))


@pytest.mark.parametrize("env_id", PARTICLES)
def test_random_actions_are_uniform_within_the_bounds_and_independent(env_id: str) -> None:
    team, data = registry.team_spec(env_id), generate(env_id, "random", 20_000)
    high = team.agents[0].action_high[0]
    joint = np.concatenate(data.actions, axis=1) / high
    assert np.abs(joint).max() <= 1
    assert np.abs(joint.mean(axis=0)).max() < 0.03
    np.testing.assert_allclose(joint.std(axis=0), 3**-0.5, rtol=0.03)
    correlations = np.corrcoef(joint.T) - np.eye(joint.shape[1])
    assert np.abs(correlations).max() < 0.04


@pytest.mark.parametrize("env_id", PARTICLES)
def test_rows_are_the_environments_own_transitions(env_id: str) -> None:
    data, env = generate(env_id, "random", 200, seed=9), registry.make(env_id, 1)
    for episode in range(3):
        seed = generation.derive_seed(9, env_id, "random", "uniform", episode)
        env.reset(np.array([0]), np.array([seed]))
        for row in np.flatnonzero(data.episodes == episode):
            np.testing.assert_array_equal(env.observe()[0][0], data.observations[0][row])
            outcome = env.step([action[row : row + 1] for action in data.actions])
            np.testing.assert_array_equal(env.observe()[0][0], data.next_observations[0][row])
            assert outcome.rewards[0][0] == data.rewards[0][row]
            assert outcome.terminated[0] == data.terminated[row]
            assert outcome.truncated[0] == data.truncated[row]


class Corridor:
    """Two agents that see and earn different things; the second one's walk ends the episode."""

    spec = TeamSpec(
        "corridor",
        (AgentSpec("agent_0", 1, (-1.0,), (1.0,)), AgentSpec("agent_1", 2, (0.0, 0.0), (1.0, 2.0))),
        3,
        9,
    )

    def __init__(self, copies: int) -> None:
        self.copies, self._at = copies, np.zeros((copies, 3))

    def reset(self, which: np.ndarray, seeds: np.ndarray) -> None:
        self._at[which] = [[0, seed % 7, 0] for seed in seeds.tolist()]

    def observe(self) -> tuple[Float32, ...]:
        seen = self._at.astype(np.float32)
        return seen[:, :1], seen[:, 1:]

    def step(self, actions: Sequence[Float32]) -> Outcome:
        self._at[:, 0] += actions[0][:, 0]
        self._at[:, 1] += actions[1][:, 1]
        self._at[:, 2] += 1
        ended = self._at[:, 1] > 10
        rewards = (actions[0][:, 0], 2 * actions[1][:, 0])
        return Outcome(rewards, ended, (self._at[:, 2] >= 9) & ~ended)

    def close(self) -> None:
        pass


class CorridorSource(RandomSource):
    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        return ("uniform",)

    def behaviour(self, env_id: str, policy: str) -> Uniform:
        return Uniform(Corridor.spec)


def test_each_agent_is_given_what_it_saw_and_earned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "team_spec", lambda env_id: Corridor.spec)
    monkeypatch.setattr(registry, "make", lambda env_id, copies: Corridor(copies))
    monkeypatch.setattr(generation, "source_of", lambda env_id: CorridorSource())
    data = generate("corridor", "random", 500)
    assert [x.shape for x in data.observations] == [(500, 1), (500, 2)]
    assert [x.shape for x in data.actions] == [(500, 1), (500, 2)]
    np.testing.assert_array_equal(data.rewards[0], data.actions[0][:, 0])
    np.testing.assert_array_equal(data.rewards[1], 2 * data.actions[1][:, 0])
    own, others = data.observations[0][:, 0], data.observations[1]
    moved = data.next_observations[1][:, 0] - others[:, 0]
    np.testing.assert_allclose(moved, data.actions[1][:, 1], atol=1e-5)
    np.testing.assert_allclose(data.next_observations[0][:, 0] - own, data.rewards[0], atol=1e-5)
    assert (others[np.diff(data.episodes, prepend=-1) == 1, 1] == 0).all()
    assert 10 < data.terminated.sum() < data.episodes.max()
    assert data.actions[1].min() >= 0
    assert 1.9 < data.actions[1][:, 1].max() <= 2


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OTC_DIST_CACHE", str(tmp_path))
    return tmp_path


def test_a_set_for_any_number_of_agents_is_made_cached_and_listed(cache: Path) -> None:
    name, calls = "predator-prey-5/random", list[int]()
    assert store.usual_size(name) == 1_000_000
    assert DatasetName.parse(name) not in known_names()
    card = store.ensure(name, 1000, lambda done, total: calls.append(done))
    assert calls[-1] == 1000
    assert list(card.files) == [f"agent_{i}" for i in range(5)]
    assert (card.episodes, card.normalised_score) == (40, None)
    assert set(card.recipe) == {"level", "seed", "otc_dist"}
    calls.clear()
    assert store.ensure(name, 1000) == card
    assert calls == []
    assert DatasetName.parse(name) in known_names()
    assert DatasetName.parse("navigation/random") in known_names()


def test_what_is_refused(cache: Path) -> None:
    with pytest.raises(UserError, match="did you mean 'predator-prey-3/random'"):
        store.ensure("predator-prey-3/medium")
    with pytest.raises(UserError, match="2 agents or more, not 1"):
        store.ensure("predator-prey-1/random", 100)
    with pytest.raises(UserError, match="unknown level 'medium'"):
        generate("navigation", "medium", 100)
