import subprocess
import sys

import numpy as np
import pytest

from otc_dist.envs import registry, smac_adapter
from otc_dist.envs.rollout import Rollout
from otc_dist.errors import UserError

from . import smac_stand_in as stand_in

STOP, NORTH = 1, 2


@pytest.fixture
def smac(monkeypatch):
    smac_adapter.team_spec.cache_clear()
    yield stand_in.install(monkeypatch)
    smac_adapter.team_spec.cache_clear()


def _orders(env, order):
    """The same order for all that are alive."""
    actions = []
    for observation, agent in zip(env.observe(), env.spec.agents, strict=True):
        alive = observation[:, -agent.choices] == 0
        actions.append(np.where(alive, order, 0).astype(np.float32)[:, None])
    return actions


def _env(copies=1, name="smac/3m"):
    env = registry.make(name, copies)
    env.reset(np.arange(copies), np.arange(copies) + 7)
    return env


def test_any_of_smacs_maps_is_an_environment_without_starting_the_game(smac):
    spec = registry.team_spec("smac/5m_vs_6m")
    assert [agent.name for agent in spec.agents] == [f"agent_{i}" for i in range(5)]
    assert spec.agents[0].observation_size == stand_in.OBSERVATION + 12
    assert spec.agents[0].choices == 12
    assert (spec.state_size, spec.max_episode_steps) == (stand_in.STATE, 70)
    assert len(registry.team_spec("smac/2m_vs_1z").agents) == 2
    assert all(game._controller is None and game.closed for game in smac.made)


def test_observations_carry_the_masks_and_the_dead_their_no_op(smac):
    smac.kills_at = {1: 2}
    env = _env(copies=2)
    seen = env.observe()
    assert [x.shape for x in seen] == [(2, stand_in.OBSERVATION + 9)] * 3
    np.testing.assert_allclose(seen[1][0, :3], [10, 11, 12])
    np.testing.assert_array_equal(seen[1][0, 7:], [0, 1, 1, 1, 0, 0, 0, 0, 0])
    env.step(_orders(env, STOP))
    np.testing.assert_array_equal(env.observe()[2][0], [*[0] * 7, 1, *[0] * 8])
    assert env.state().shape == (2, stand_in.STATE)
    env.step(_orders(env, STOP))  # the dead take the no-op
    np.testing.assert_array_equal(seen[1][0, :3], [10, 11, 12])  # the caller's own


def test_a_battle_is_won(smac):
    env = _env()
    outcome = env.step(_orders(env, NORTH))
    assert [float(reward[0]) for reward in outcome.rewards] == [1.5] * 3
    assert not outcome.terminated[0]
    for _ in range(3):
        assert not env.success[0]
        outcome = env.step(_orders(env, NORTH))
    assert outcome.terminated[0] and not outcome.truncated[0] and env.success[0]
    (game,) = [game for game in smac.made if game._controller]
    assert game.get_stats()["battles_won"] == 1


def test_a_battle_is_lost(smac):
    smac.kills_at = {1: 0, 2: 1, 3: 2}
    env = _env()
    outcomes = [env.step(_orders(env, STOP)) for _ in range(3)]
    assert [bool(outcome.terminated[0]) for outcome in outcomes] == [False, False, True]
    assert not env.success[0]


def test_the_limit_truncates(smac):
    env = _env()
    outcomes = [env.step(_orders(env, STOP)) for _ in range(4)]
    assert [bool(outcome.truncated[0]) for outcome in outcomes] == [False, False, False, True]
    assert not any(outcome.terminated[0] for outcome in outcomes)


def test_a_protocol_error_is_no_end_of_a_battle(smac, caplog):
    smac.breaks_at = (2,)
    env = _env(copies=2)
    env.step(_orders(env, NORTH))
    before, state = env.observe(), env.state()
    smac.breaks_at = ()
    games = [game for game in smac.made if game._controller]
    games[1].breaks_at = (2,)
    outcome = env.step(_orders(env, NORTH))
    np.testing.assert_array_equal(outcome.terminated & outcome.truncated, [False, True])
    np.testing.assert_array_equal(outcome.rewards[0], [1.5, 0])
    np.testing.assert_array_equal(env.observe()[0][1], before[0][1])  # it did not happen
    np.testing.assert_array_equal(env.state()[1], state[1])
    assert not env.success.any()
    assert "broke off in copy 1" in caplog.text
    env.reset(np.array([1]), np.array([3]))
    assert not env.step(_orders(env, NORTH)).terminated.any()


def test_an_evaluation_counts_whole_battles_only(smac):
    smac.breaks_at = (3,)
    env = registry.make("smac/3m", 2)
    rollout = Rollout(env, 0, "evaluation", 0)
    while not rollout.finished:
        rollout.advance(_orders(env, NORTH), (False,) * 3)
    assert rollout.step == 3 + 4
    assert rollout.episode_lengths == (4, 4)
    assert rollout.successes == (True, True)
    assert rollout.episode_returns == (6.0, 6.0)


def test_versions_of_the_game_are_told(smac):
    env = registry.make("smac/3m", 1)
    assert "StarCraft II" not in env.versions
    rollout = Rollout(env, 0, "deployment", 1)
    assert rollout.simulator["StarCraft II"] == stand_in.GAME_VERSION


def test_a_copys_first_seed_is_the_games(smac):
    env = _env(copies=2)
    env.reset(np.array([1]), np.array([99]))
    assert [game.seed for game in smac.made if game._controller] == [7, 8]
    env.close()
    assert all(game.closed for game in smac.made)


def test_actions_are_checked_before_any_game_steps(smac):
    env = _env(copies=2)
    actions = _orders(env, NORTH)
    actions[2][1] = 8
    with pytest.raises(ValueError, match="agent_2 cannot take action 8 in copy 1"):
        env.step(actions)
    np.testing.assert_array_equal(env.state()[:, 0], 1000 * stand_in.HEALTH)


def test_what_cannot_be_is_one_line(smac):
    with pytest.raises(UserError, match="unknown SMAC map '5m_vs_7m'; did you mean '5m_vs_6m'"):
        registry.team_spec("smac/5m_vs_7m")
    with pytest.raises(UserError, match="cannot go back"):
        _env().set_state(np.zeros((1, stand_in.STATE)))
    smac.missing = True
    with pytest.raises(UserError, match=r"StarCraft II cannot be started \(.*SC2PATH") as error:
        _env()
    assert "\n" not in str(error.value)


def test_without_the_package_one_line_says_what_to_install():
    code = (
        "import sys\n"
        "sys.modules['smac'] = None\n"
        "from otc_dist.envs import registry\n"
        "from otc_dist.errors import run_main\n"
        "run_main(lambda argv: registry.team_spec('smac/5m_vs_6m') and 0)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: smac/5m_vs_6m needs SMAC, and smac.env is missing: pip")
    assert ended.stderr.count("\n") == 1
