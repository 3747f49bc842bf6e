"""The robots' tasks as functions of what one agent sees, held against real rollouts."""

from functools import cache

import numpy as np
import pytest
import torch

from otc_dist.envs import registry
from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.envs.rollout import Rollout
from otc_dist.transitions import Transitions

COPIES, STEPS = 32, 250
# Correlation with the true reward, and the error's standard deviation, at least and at most:
# what was measured, and a little room. HalfCheetah's torso jerks most within a step.
ACCURACY = {
    "hopper-1x3": (0.9999, 0.01),
    "hopper-3x1": (0.9999, 0.01),
    "walker2d-1x6": (0.9995, 0.03),
    "walker2d-2x3": (0.9995, 0.03),
    "halfcheetah-1x6": (0.98, 0.12),
    "halfcheetah-2x3": (0.96, 0.14),
}


@cache
def played(env_id: str) -> Transitions:
    """What agent 0 sees of a team whose actions change slowly, so that robots move and fall."""
    env = registry.make(env_id, COPIES)
    rollout = Rollout(env, seed=0, phase="deployment", deployment=1)
    random = np.random.default_rng(0)
    actions = [np.zeros((COPIES, agent.action_size), np.float32) for agent in env.spec.agents]
    steps = []
    for _ in range(STEPS):
        for action in actions:
            change = random.standard_normal(action.shape, np.float32)
            action[:] = np.clip(0.9 * action + 0.4 * change, -1, 1)
        steps.append(rollout.advance(actions, (False,) * len(actions)))
    env.close()
    return Transitions.concatenate([step.of_agent(0) for step in steps])


@pytest.mark.parametrize("env_id", PARTITIONS)
def test_termination_is_the_environments(env_id: str) -> None:
    data, task = played(env_id), registry.task(env_id)
    assert task is not None
    np.testing.assert_array_equal(task.terminated(data.next_observations), data.terminated)
    assert data.terminated.any() == (not env_id.startswith("halfcheetah"))


@pytest.mark.parametrize("env_id", PARTITIONS)
def test_reward_is_nearly_the_environments(env_id: str) -> None:
    data, task = played(env_id), registry.task(env_id)
    assert task is not None
    reward = task.reward(data.observations, data.actions, data.next_observations)
    correlation, error = ACCURACY[env_id]
    assert np.corrcoef(reward, data.rewards)[0, 1] > correlation
    assert np.std(reward - data.rewards) < error


def test_an_agent_pays_for_its_own_actions_only() -> None:
    """All of it where one agent moves all joints; with others, theirs is missing."""
    alone, team = (registry.task(env_id) for env_id in ("halfcheetah-1x6", "halfcheetah-2x3"))
    assert alone is not None and team is not None
    states = np.zeros((1, 17), np.float32)
    assert alone.reward(states, np.ones((1, 6), np.float32), states) == pytest.approx(-0.6)
    assert team.reward(states, np.ones((1, 3), np.float32), states) == pytest.approx(-0.3)


@pytest.mark.parametrize("env_id", PARTITIONS)
def test_tensors_of_any_leading_shape_give_what_arrays_give(env_id: str) -> None:
    data, task = played(env_id), registry.task(env_id)
    assert task is not None
    arrays = (data.observations, data.actions, data.next_observations)
    reward = task.reward(
        *(torch.from_numpy(array).unflatten(0, (STEPS, COPIES)) for array in arrays)
    )
    ended = task.terminated(torch.from_numpy(data.next_observations).unflatten(0, (STEPS, COPIES)))
    assert reward.shape == ended.shape == (STEPS, COPIES)
    np.testing.assert_allclose(reward.flatten(), task.reward(*arrays), atol=1e-6)
    np.testing.assert_array_equal(ended.flatten(), data.terminated)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 101.0])
def test_a_hopper_whose_state_is_out_of_bounds_has_fallen(value: float) -> None:
    task = registry.task("hopper-1x3")
    assert task is not None
    standing = np.zeros((1, 11), np.float32)
    standing[0, 0] = 1.25
    assert not task.terminated(standing)
    standing[0, 7] = value
    assert task.terminated(standing)


def test_walker_falls_upwards_too_and_hopper_does_not() -> None:
    hopper, walker = registry.task("hopper-1x3"), registry.task("walker2d-1x6")
    assert hopper is not None and walker is not None
    for height, fallen in ((0.75, (False, True)), (1.0, (False, False)), (2.1, (False, True))):
        states = [np.zeros((1, size), np.float32) for size in (11, 17)]
        for state in states:
            state[0, 0] = height
        assert (bool(hopper.terminated(states[0])), bool(walker.terminated(states[1]))) == fallen
