import json
import subprocess
import sys

import numpy as np
import pytest

from otc_dist.datasets.generate import generate
from otc_dist.envs import registry, smac_adapter
from otc_dist.envs.rollout import Rollout
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import choice_problem

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


def test_random_data_leave_out_what_broke_off(smac):
    # In each of 8 games: the first step of its first episode, and the second one of its third.
    smac.breaks_at = (1, 7)
    data = generate("smac/3m", "random", 40)
    assert np.bincount(data.episodes).tolist() == [4] * 8 + [1] * 8
    assert data.truncated[-8:].all() and not data.terminated[-8:].any()
    assert all(choice_problem(data.of_agent(agent), 9) is None for agent in range(3))
    for agent in range(3):  # s' = s would say that a step did not happen
        moved = data.next_observations[agent] != data.observations[agent]
        assert moved.any(axis=1).all()


def test_few_games_are_played_at_once_where_nobody_says_how_many(smac):
    assert registry.affordable("smac/3m", 100) == 8
    assert registry.affordable("smac/3m", 2) == 2
    assert registry.affordable("5m_vs_6m", 100) == 100
    generate("smac/3m", "random", 1000)
    assert len([game for game in smac.made if game._controller]) == 1 + 8


@pytest.mark.slow
def test_the_launcher_tunes_it_over_the_bus(tmp_path, tiny_flags):
    environment = stand_in.write(tmp_path / "packages")
    diary = tmp_path / "diary"
    command = [
        *(sys.executable, "-m", "otc_dist.launch", "5m_vs_6m", "--out", "run", *tiny_flags),
        *("--set", "env.id=smac/5m_vs_6m", "--set", "dataset.name=random"),
        *("--set", "algorithm.name=discrete-cql"),
        *("--set", "evaluation.episodes=11", "--set", "deployment.count=1"),
    ]
    ended = subprocess.run(
        command,
        cwd=tmp_path,
        env={**environment, stand_in.DIARY: str(diary)},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert "after deployment 1" in ended.stdout
    folder = RunFolder(tmp_path / "run")
    assert folder.deployment(1).stat().st_size > 0
    for k in range(2):
        result = json.loads(folder.evaluation(k).read_text())
        for what in ("returns", "lengths", "seeds", "successes"):
            assert len(result[what]) == 11
        assert len(set(result["seeds"])) == 11
    games = [int(line) for line in diary.read_text().splitlines()]
    assert max(games) == 8


@pytest.mark.parametrize("command", [[], ["--dry-run"]])
def test_without_the_package_one_line_says_what_to_install(tmp_path, command):
    code = (
        "import sys\n"
        "sys.modules['smac'] = None\n"
        "from otc_dist.terminal.errors import run_main\n"
        "from otc_dist.launch.__main__ import main\n"
        "run_main(main)\n"
    )
    words = ["5m_vs_6m", "--set", "env.id=smac/5m_vs_6m", "--set", "dataset.name=random", *command]
    ended = subprocess.run(
        [sys.executable, "-c", code, *words],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr.startswith(
        "error: smac/5m_vs_6m needs SMAC, and smac.env is missing:"
        f" {sys.executable} -m pip install git+https://"
    )
    assert ended.stderr.count("\n") == 1
