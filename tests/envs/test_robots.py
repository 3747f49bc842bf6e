"""Our robots against gymnasium's v4 tasks, to the bit."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from otc_dist.datasets.behaviour import load_card, load_policy
from otc_dist.envs.robot_specs import PARTITIONS, single_agent_id, team_spec
from otc_dist.envs.robots import RobotEnv

GYMNASIUM = {"hopper": "Hopper-v4", "halfcheetah": "HalfCheetah-v4", "walker2d": "Walker2d-v4"}
COPIES = 3

# We compare with v4 on purpose: see `robot_specs`.
pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def _against_gymnasium(robot, actions_of, steps):
    """Step COPIES copies beside as many gymnasium environments; everything must be equal."""
    env = RobotEnv(single_agent_id(robot), COPIES)
    joints = PARTITIONS[single_agent_id(robot)][0].joints
    references = [gymnasium.make(GYMNASIUM[robot]) for _ in range(COPIES)]
    seeds = np.arange(COPIES) + 2**40
    env.reset(np.arange(COPIES), seeds)
    for reference, row, seed in zip(references, env.observe()[0], seeds, strict=True):
        np.testing.assert_array_equal(
            row, reference.reset(seed=int(seed))[0].astype(np.float32), strict=True
        )
    ends = 0
    for step in range(steps):
        actions = actions_of(step, env.observe()[0])
        outcome, observed, state = env.step([actions]), env.observe()[0], env.state()
        for copy, reference in enumerate(references):
            # D4RL and we clip before the step; gymnasium charges for the action that it is given.
            expected = reference.step(np.clip(actions[copy], -1, 1))
            data = reference.unwrapped.data
            np.testing.assert_array_equal(state[copy, 1 : 1 + joints], data.qpos, strict=True)
            np.testing.assert_array_equal(
                state[copy, 1 + joints : 1 + 2 * joints], data.qvel, strict=True
            )
            np.testing.assert_array_equal(
                observed[copy], expected[0].astype(np.float32), strict=True
            )
            assert outcome.rewards[0][copy] == np.float32(expected[1])
            assert outcome.terminated[copy] == expected[2]
            assert outcome.truncated[copy] == (expected[3] and not expected[2])
            if expected[2] or expected[3]:
                ends += 1
                seed = 1000 * step + copy
                env.reset(np.array([copy]), np.array([seed]))
                reference.reset(seed=seed)
    return ends


@pytest.fixture(autouse=True)
def _log_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # MuJoCo writes its warnings about gymnasium's HalfCheetah model into the current folder.
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("robot", GYMNASIUM)
def test_random_episodes_equal_gymnasium(robot):
    rng = np.random.default_rng(0)
    size = PARTITIONS[single_agent_id(robot)][0].actuators

    def act(step, _):
        return rng.uniform(-1.3, 1.3, (COPIES, size)).astype(np.float32)

    assert _against_gymnasium(robot, act, steps=1100) >= COPIES


@pytest.mark.parametrize("robot", GYMNASIUM)
def test_policy_episodes_equal_gymnasium(robot):
    policy, rng = load_policy(robot, load_card(robot).medium), np.random.default_rng(1)
    size = PARTITIONS[single_agent_id(robot)][0].actuators

    def act(_, observations):
        return policy.act(observations, rng.standard_normal((COPIES, size), np.float32))

    assert _against_gymnasium(robot, act, steps=1100) >= COPIES


@pytest.mark.parametrize("env_id", PARTITIONS)
def test_agents_share_what_they_see_and_earn(env_id):
    spec, env = team_spec(env_id), RobotEnv(env_id, 2)
    env.reset(np.arange(2), np.arange(2))
    actions = [np.full((2, agent.action_size), 0.1, np.float32) for agent in spec.agents]
    outcome = env.step(actions)
    assert len(outcome.rewards) == len(env.observe()) == len(spec.agents)
    for rewards, observations in zip(outcome.rewards, env.observe(), strict=True):
        np.testing.assert_array_equal(rewards, outcome.rewards[0])
        assert observations.shape == (2, spec.agents[0].observation_size)
    assert env.state().shape == (2, spec.state_size)


def test_partition_is_contiguous_and_ascending():
    whole, split = RobotEnv("walker2d-1x6", 1), RobotEnv("walker2d-2x3", 1)
    actions = np.linspace(-1, 1, 6, dtype=np.float32)[None]
    for env, parts in ((whole, [actions]), (split, [actions[:, :3], actions[:, 3:]])):
        env.reset(np.array([0]), np.array([5]))
        env.step(parts)
    np.testing.assert_array_equal(whole.state(), split.state())


@pytest.mark.parametrize("copies", [1, 5, 70])  # 70: on several threads, where there are any
def test_a_copy_does_not_depend_on_the_others(copies):
    alone, together = RobotEnv("hopper-3x1", 1), RobotEnv("hopper-3x1", copies)
    alone.reset(np.array([0]), np.array([7]))
    together.reset(np.arange(copies), np.arange(copies) + 7)
    rng = np.random.default_rng(0)
    for _ in range(50):
        actions = [rng.uniform(-1, 1, (copies, 1)).astype(np.float32) for _ in range(3)]
        ours, theirs = alone.step([a[:1] for a in actions]), together.step(actions)
        assert ours.rewards[0][0] == theirs.rewards[0][0]
    np.testing.assert_array_equal(alone.state()[0], together.state()[0])


def test_state_can_be_set_and_stepped_again():
    env, other = RobotEnv("walker2d-2x3", 2), RobotEnv("walker2d-2x3", 2)
    env.reset(np.arange(2), np.arange(2))
    rng = np.random.default_rng(0)

    def draw():
        return [rng.uniform(-1, 1, (2, 3)).astype(np.float32) for _ in range(2)]

    for _ in range(30):
        env.step(draw())
    before, actions = env.state(), draw()
    other.set_state(before)
    env.step(actions)
    other.step(actions)
    np.testing.assert_array_equal(env.state(), other.state())
    with pytest.raises(ValueError, match="shape"):
        other.set_state(before[:1])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_action_that_is_not_finite_moves_nothing(value):
    env = RobotEnv("hopper-3x1", 2)
    env.reset(np.arange(2), np.arange(2))
    before = env.state()
    actions = [np.zeros((2, 1), np.float32) for _ in range(3)]
    actions[1][1] = value
    with pytest.raises(ValueError, match="not finite"):
        env.step(actions)
    np.testing.assert_array_equal(env.state(), before)


@pytest.mark.parametrize("actions", [[], [np.zeros((2, 1), np.float32)] * 2, [np.zeros(2)] * 3])
def test_actions_of_the_wrong_shape_are_refused(actions):
    env = RobotEnv("hopper-3x1", 2)
    env.reset(np.arange(2), np.arange(2))
    with pytest.raises(ValueError, match=r"actions|shape"):
        env.step(actions)


def test_observations_belong_to_the_caller():
    env = RobotEnv("hopper-1x3", 1)
    env.reset(np.array([0]), np.array([0]))
    first = env.observe()[0]
    kept = first.copy()
    env.step([np.ones((1, 3), np.float32)])
    env.observe()
    np.testing.assert_array_equal(first, kept)
