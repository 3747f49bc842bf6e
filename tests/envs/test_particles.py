"""The particle tasks: rewards and moves by hand, and what every batched environment owes."""

import numpy as np
import pytest
import torch

from otc_dist.datasets.generate import generate
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError

IDS = ("predator-prey-2", "predator-prey-3", "cooperative-navigation-2",
       "cooperative-navigation-6", "navigation")  # fmt: skip


def _at(env_id, *points):
    """One copy with its points (agents first) at these places."""
    env = registry.make(env_id, 1)
    beta = [0.1] if env_id == "navigation" else []
    env.set_state(np.array([[0.0, *np.ravel(points), *beta]]))
    return env


def _still(env):
    return [np.zeros((env.copies, 2), np.float32) for _ in env.spec.agents]


def _draw(env, rng, copies=None):
    """Actions of `copies` copies, a little beyond the bounds."""
    return [
        rng.uniform(-1.2, 1.2, (copies or env.copies, 2)).astype(np.float32) * agent.action_high[0]
        for agent in env.spec.agents
    ]


# --- Cooperative Navigation -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("points", "reward"),
    [
        ([(0, 0), (1, 0), (0.3, 0.4), (1, 1)], -1.5),  # one landmark each: 0.5 and 1
        ([(0, 0), (1, 1), (0.3, 0.4), (0, -0.5)], -1.0),  # one agent is closest to both
        ([(0.5, 0.5), (-0.5, 0.5), (-0.5, 0.5), (0.5, 0.5)], 0.0),  # all covered
    ],
)
def test_cooperative_navigation_sums_each_landmarks_distance_to_the_closest_agent(points, reward):
    env = _at("cooperative-navigation-2", *points)
    outcome = env.step(_still(env))
    assert [rewards.tolist() for rewards in outcome.rewards] == [[pytest.approx(reward)]] * 2
    assert not outcome.terminated[0]


def test_the_reward_is_that_of_the_state_reached():
    env = _at("cooperative-navigation-2", (0, 0), (1, 1), (0.1, 0), (1, 1))
    outcome = env.step([np.array([[0.1, 0]], np.float32), np.zeros((1, 2), np.float32)])
    assert outcome.rewards[0][0] == pytest.approx(0.0, abs=1e-7)


# --- Predator-Prey ----------------------------------------------------------------------------


def _prey(env):
    return env.observe()[0][0, -2:].tolist()


@pytest.mark.parametrize(
    ("agents", "reward"),
    [
        ([(0.95, 0.95), (0.93, 0.98), (0, 0)], 2),
        ([(0.95, 0.95), (0.5, 0.5), (0, 0)], 1),
        ([(0.95, 0.95), (0.93, 0.98), (1, 0.91)], 3),
        ([(0.9, 0.99), (0, 0), (0, 0)], 0),  # 0.1005 away
    ],
)
def test_all_agents_are_given_one_for_each_that_collides(agents, reward):
    env = _at("predator-prey-3", *agents, (1, 1))  # in the corner the prey cannot flee further
    outcome = env.step(_still(env))
    assert [rewards.tolist() for rewards in outcome.rewards] == [[reward]] * 3
    assert not outcome.terminated[0]


@pytest.mark.parametrize(
    ("agents", "prey", "then"),
    [
        ([(0.1, 0), (-1, -1)], (0.2, 0.05), (0.33, 0.115)),  # away from the nearest, at 0.13
        ([(0.1, 0), (0.25, 0.05)], (0.2, 0.05), (0.07, 0.05)),  # only the nearest counts
        ([(-1, -1), (1, 1)], (0.5, -0.25), (0.37, -0.185)),  # nobody near: home
        ([(-1, -1), (1, 1)], (0.05, 0.02), (0, 0)),  # and no farther
        ([(0.2, 0.05), (1, 1)], (0.2, 0.05), (0.2, 0.05)),  # an agent on top of it
        ([(0.85, 0), (1, 1)], (0.95, 0), (1, 0)),  # a wall
    ],
)
def test_the_prey_follows_its_rule(agents, prey, then):
    env = _at("predator-prey-2", *agents, prey)
    env.step(_still(env))
    assert _prey(env) == pytest.approx(then, abs=1e-6)


def test_the_prey_sees_where_the_agents_were():
    env = _at("predator-prey-2", (0.3, 0), (-1, -1), (0.51, 0))  # 0.21 apart: out of its sight
    env.step([np.array([[0.1, 0]], np.float32), np.zeros((1, 2), np.float32)])
    assert _prey(env) == pytest.approx((0.38, 0), abs=1e-6)


def test_the_prey_is_faster_than_an_agent_in_every_direction():
    for angle in np.linspace(0, 2 * np.pi, 17):
        way = np.array([np.cos(angle), np.sin(angle)])
        start = -way / 2
        env = _at("predator-prey-2", start, (1, 1), start + 0.15 * way)
        env.step([(10 * way[None]).astype(np.float32), np.zeros((1, 2), np.float32)])
        gap = np.linalg.norm(env.observe()[0][0, -2:] - env.observe()[0][0, :2])
        moved = np.linalg.norm(env.observe()[0][0, -2:] - (start + 0.15 * way))
        assert moved >= 0.13 - 1e-6
        assert gap > 0.1


def _mean_return(agents_that_chase):
    env, rng = registry.make("predator-prey-3", 2000), np.random.default_rng(0)
    env.reset(np.arange(2000), np.arange(2000))
    total = np.zeros(2000)
    for _ in range(env.spec.max_episode_steps):
        seen, actions = env.observe()[0], _draw(env, rng)
        for i in range(agents_that_chase):
            actions[i] = seen[:, -2:] - seen[:, 2 * i : 2 * i + 2]
        total += env.step(actions).rewards[0]
    return total.mean()


def test_random_data_hold_rewards_and_chasing_together_pays():
    """What the prey's rule was chosen for, as its docstring says."""
    assert 0.15 < _mean_return(0) < 0.4
    assert 2.5 < _mean_return(1) < 4.5
    assert _mean_return(3) > 7.5


# --- What every particle task owes ------------------------------------------------------------


@pytest.mark.parametrize("env_id", IDS)
def test_actions_are_velocities_up_to_the_bounds_and_walls_hold(env_id):
    env = registry.make(env_id, 1, 0.0)  # Navigation's velocity is then 0.1 a
    agents, limit = len(env.spec.agents), env.spec.agents[0].action_high[0]
    env.reset(np.array([0]), np.array([0]))
    start = env.state()
    start[0, 1 : 1 + 2 * agents] = 0.95
    env.set_state(start)
    action = np.array([[limit / 2, -5 * limit]], np.float32)
    env.step([action] * agents)
    own = env.observe()[0][0, : 2 * agents].reshape(agents, 2)
    np.testing.assert_allclose(own, [[1.0, 0.85]] * agents, atol=1e-6)


@pytest.mark.parametrize("env_id", IDS)
def test_an_initial_state_depends_on_its_seed_alone(env_id):
    env, other = registry.make(env_id, 3), registry.make(env_id, 2)
    env.reset(np.arange(3), np.array([5, 6, 7]))
    first = env.state()
    other.reset(np.array([1]), np.array([6]))
    np.testing.assert_array_equal(other.state()[1], first[1])
    assert len(np.unique(first[:, 1])) == 3
    points = first[:, 1 : 1 + env.spec.agents[0].observation_size]
    assert np.abs(points).max() <= 1
    env.step(_still(env))
    before = env.state()
    env.reset(np.array([2]), np.array([5]))  # and leaves the other copies alone
    np.testing.assert_array_equal(env.state()[:2], before[:2])
    np.testing.assert_array_equal(env.state()[2], first[0])


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("copies", [1, 5])
def test_a_copy_does_not_depend_on_the_others(env_id, copies):
    alone, together = registry.make(env_id, 1), registry.make(env_id, copies)
    alone.reset(np.array([0]), np.array([copies + 6]))
    together.reset(np.arange(copies), np.arange(copies) + 7)
    rng = np.random.default_rng(0)
    for _ in range(25):
        actions = _draw(together, rng)
        ours, theirs = alone.step([a[-1:] for a in actions]), together.step(actions)
        for mine, yours in zip(ours.rewards, theirs.rewards, strict=True):
            assert mine[0] == yours[-1]
        assert ours.terminated[0] == theirs.terminated[-1]
        np.testing.assert_array_equal(alone.state()[0], together.state()[-1])


@pytest.mark.parametrize("env_id", IDS)
def test_state_can_be_set_and_stepped_again(env_id):
    env, other = registry.make(env_id, 3), registry.make(env_id, 3)
    env.reset(np.arange(3), np.arange(3))
    rng = np.random.default_rng(0)
    for _ in range(7):
        env.step(_draw(env, rng))
    state, actions = env.state(), _draw(env, rng)
    assert state.shape == (3, env.spec.state_size)
    assert state.dtype == np.float64
    other.set_state(state)
    np.testing.assert_array_equal(other.observe()[0], env.observe()[0])
    ours, theirs = env.step(actions), other.step(actions)
    np.testing.assert_array_equal(env.state(), other.state())
    np.testing.assert_array_equal(ours.rewards[0], theirs.rewards[0])
    with pytest.raises(ValueError, match="shape"):
        other.set_state(state[:, :-1])


@pytest.mark.parametrize("env_id", IDS)
def test_an_episode_is_truncated_after_25_steps(env_id):
    env = registry.make(env_id, 200, 0.0)
    env.reset(np.arange(200), np.arange(200))
    far = env.state()
    far[:, 1:3] = 0.9
    env.set_state(far)
    ends = [env.step(_still(env)).truncated for _ in range(25)]
    assert not np.any(ends[:24])
    assert ends[24].all()


@pytest.mark.parametrize("env_id", IDS)
def test_agents_observe_the_same_and_it_belongs_to_the_caller(env_id):
    env = registry.make(env_id, 2)
    env.reset(np.arange(2), np.arange(2))
    seen = env.observe()
    assert len(seen) == len(env.spec.agents)
    assert all(array is seen[0] for array in seen)  # so that data sets keep it once
    np.testing.assert_array_equal(seen[0], env.state()[:, 1 : 1 + seen[0].shape[1]])
    kept = seen[0].copy()
    env.step([np.full((2, 2), 0.1, np.float32) for _ in seen])
    np.testing.assert_array_equal(seen[0], kept)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_moves_nothing(env_id, value):
    env = registry.make(env_id, 2)
    env.reset(np.arange(2), np.arange(2))
    before, actions = env.state(), _still(env)
    actions[-1][1, 0] = value
    with pytest.raises(ValueError, match="not finite"):
        env.step(actions)
    np.testing.assert_array_equal(env.state(), before)


@pytest.mark.parametrize("env_id", IDS)
def test_actions_of_the_wrong_shape_are_refused(env_id):
    env = registry.make(env_id, 2)
    env.reset(np.arange(2), np.arange(2))
    for actions in (
        [],
        _still(env)[1:],
        [a[:1] for a in _still(env)],
        [a[:, :1] for a in _still(env)],
    ):
        with pytest.raises(ValueError, match=r"actions|shape"):
            env.step(actions)


@pytest.mark.parametrize("env_id", IDS)
def test_the_task_tells_the_environments_own_rewards_and_ends(env_id):
    task, data = registry.task(env_id), generate(env_id, "random", 20_000)
    assert task is not None
    assert np.unique(data.rewards[0]).size > 1
    for i in range(len(data.rewards)):
        s, a, then = data.observations[i], data.actions[i], data.next_observations[i]
        np.testing.assert_allclose(task.reward(s, a, then), data.rewards[i], rtol=1e-6)
        np.testing.assert_array_equal(task.terminated(then), data.terminated)
    folded = torch.from_numpy(then).reshape(200, 100, -1)  # any leading shape
    reward, ended = task.reward(folded, None, folded), task.terminated(folded)
    assert reward.dtype == torch.float32
    assert ended.dtype == torch.bool
    np.testing.assert_allclose(reward.reshape(-1), data.rewards[-1], rtol=1e-6)
    np.testing.assert_array_equal(ended.reshape(-1), data.terminated)


def test_ids_carry_the_number_of_agents():
    for env_id, agents, observed in (
        ("predator-prey-5", 5, 12),
        ("cooperative-navigation-6", 6, 24),
        ("navigation", 1, 2),
    ):
        team = registry.team_spec(env_id)
        assert len(team.agents) == agents
        assert {agent.observation_size for agent in team.agents} == {observed}
        assert registry.known(env_id)
        assert registry.normalised_score(env_id, 1.0) is None
    assert {agent.action_low for agent in registry.team_spec("predator-prey-3").agents} == {
        (-0.1, -0.1)
    }


@pytest.mark.parametrize("agents", [0, 1])
@pytest.mark.parametrize("task", ["predator-prey", "cooperative-navigation"])
def test_too_few_agents_are_refused_in_one_line(task, agents):
    for ask in (
        registry.team_spec,
        registry.task,
        lambda name: registry.make(name, 1),
        lambda name: generate(name, "random", 10),
    ):
        with pytest.raises(UserError, match=f"2 agents or more, not {agents}") as caught:
            ask(f"{task}-{agents}")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "name", ["predator-prey", "predator-prey-x", "predator-prey-03", "navigation-1"]
)
def test_an_unknown_id_is_answered_with_the_nearest(name):
    assert not registry.known(name)
    with pytest.raises(UserError, match=r"did you mean '(predator-prey-3|navigation)'"):
        registry.team_spec(name)


def test_no_copies_are_refused():
    with pytest.raises(ValueError, match="at least one copy"):
        registry.make("predator-prey-3", 0)
