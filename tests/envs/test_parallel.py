import numpy as np
import pytest
from gymnasium.spaces import Discrete
from pettingzoo.test import parallel_api_test, parallel_seed_test

from otc_dist.envs import registry
from otc_dist.envs.parallel import ParallelView


class _Available(Discrete):
    """Samples what is available now: PettingZoo's tests for parallel environments know no masks."""

    mask = None

    def sample(self, mask=None, probability=None):
        return super().sample(mask=self.mask)


class _Masked(ParallelView):
    """The view, with action spaces that follow the infos' masks."""

    def __init__(self, env):
        super().__init__(env)
        for name, space in self.action_spaces.items():
            if isinstance(space, Discrete):
                self.action_spaces[name] = _Available(space.n)

    def reset(self, seed=None, options=None):
        observations, infos = super().reset(seed, options)
        return observations, self._noted(infos)

    def step(self, actions):
        *outcome, infos = super().step(actions)
        return *outcome, self._noted(infos)

    def _noted(self, infos):
        for name, info in infos.items():
            if "action_mask" in info:
                self.action_spaces[name].mask = info["action_mask"]
        return infos


@pytest.mark.parametrize("env_id", registry.env_ids())
def test_pettingzoo_accepts_it(env_id):
    parallel_api_test(_Masked(registry.make(env_id, 1)), num_cycles=100)
    parallel_seed_test(lambda: _Masked(registry.make(env_id, 1)), num_cycles=20)


def _view():
    return ParallelView(registry.make("hopper-3x1", 1))


def test_it_plays_the_batched_environment():
    view, env = _view(), registry.make("hopper-3x1", 1)
    observations, _ = view.reset(seed=11)
    env.reset(np.array([0]), np.array([11]))
    action = np.array([0.3], np.float32)
    while view.agents:
        np.testing.assert_array_equal(observations["agent_1"], env.observe()[1][0])
        observations, rewards, terminated, truncated, _ = view.step(
            dict.fromkeys(view.agents, action)
        )
        outcome = env.step([action[None]] * 3)
        assert rewards["agent_2"] == outcome.rewards[2][0]
    assert terminated["agent_0"] == outcome.terminated[0]
    assert truncated["agent_0"] == outcome.truncated[0]
    np.testing.assert_array_equal(observations["agent_1"], env.observe()[1][0])  # the true s'


def test_spaces_are_float32_and_stay_the_same_objects():
    view = _view()
    for agent in view.possible_agents:
        assert view.observation_space(agent) is view.observation_space(agent)
        assert view.observation_space(agent).dtype == np.float32
        assert view.action_space(agent).shape == (1,)


def test_what_it_refuses():
    with pytest.raises(ValueError, match="one copy"):
        ParallelView(registry.make("hopper-3x1", 2))
    view, action = _view(), np.zeros(1, np.float32)
    with pytest.raises(ValueError, match="call reset"):
        view.step({})
    view.reset(seed=0)
    with pytest.raises(ValueError, match="agents are"):
        view.step({"agent_0": action})
    with pytest.raises(ValueError, match="not finite"):
        view.step(dict.fromkeys(view.agents, action * np.nan))


def test_discrete_actions_are_indices_and_their_masks_are_in_the_infos():
    view = ParallelView(registry.make("5m_vs_6m", 1))
    assert view.action_space("agent_0") == Discrete(12)
    observations, infos = view.reset(seed=1)
    for name in view.agents:
        mask = infos[name]["action_mask"]
        assert mask.dtype == np.int8
        np.testing.assert_array_equal(mask, observations[name][-12:])
    _, _, _, _, infos = view.step(dict.fromkeys(view.agents, np.int64(4)))  # east
    np.testing.assert_array_equal(infos["agent_2"]["action_mask"], [0, 1, 1, 1, 1, 1, *[0] * 6])
    view.step(dict.fromkeys(view.agents, 1))
    with pytest.raises(ValueError, match="agent_0 cannot take action 0"):
        view.step(dict.fromkeys(view.agents, 0))
