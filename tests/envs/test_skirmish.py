import numpy as np
import pytest

from otc_dist.envs import registry
from otc_dist.envs.skirmish_rules import GRID, JITTER

from .battles import (
    AGENTS,
    CAMP,
    EAST,
    ENEMIES,
    HOME,
    NO_OP,
    NORTH,
    SOUTH,
    STOP,
    UNITS,
    WEST,
    attack,
    battle,
    health_of,
    masks_of,
    places_of,
    play,
    random_actions,
)


def test_shapes_are_those_of_smac():
    spec = registry.team_spec("5m_vs_6m")
    assert [agent.observation_size for agent in spec.agents] == [55 + 12] * 5
    assert [agent.choices for agent in spec.agents] == [12] * 5
    assert spec.agents[0].action_high == (11.0,)
    assert spec.max_episode_steps == 70


def test_sides_start_around_the_maps_points_and_never_overlap():
    env = registry.make("5m_vs_6m", 200)
    env.reset(np.arange(200), np.arange(200))
    places = env.state()[:, 1 : 1 + 2 * UNITS].reshape(200, 2, UNITS).swapaxes(1, 2)
    middle = places[:, :AGENTS].mean(axis=1) / GRID
    assert np.abs(middle - (9, 16)).max() < 1
    assert np.abs(places[:, AGENTS:].mean(axis=1) / GRID - (23, 16)).max() < 0.2
    gaps = np.linalg.norm(places[:, :, None] - places[:, None], axis=3) + 1e9 * np.eye(UNITS)
    assert gaps.min() >= 0.75 * GRID
    assert np.ptp(places, axis=0).max() > 1.8 * JITTER


def test_what_an_agent_observes_by_hand():
    enemies = [(12.0, 16.0), (9.0, 22.0), *CAMP[2:]]
    env = battle([(9.0, 16.0), (9.0, 12.0), *HOME[2:]], enemies, {0: 30, 1: 15, 5: 9, 2: 0})
    seen = env.observe()[0][0]
    assert seen.shape == (67,)
    np.testing.assert_array_equal(seen[:4], [1, 1, 1, 1])  # may move anywhere
    np.testing.assert_allclose(seen[4:9], [1, 3 / 9, 3 / 9, 0, 9 / 45], rtol=1e-6)
    np.testing.assert_allclose(seen[9:14], [1, 6 / 9, 0, 6 / 9, 1], rtol=1e-6)
    np.testing.assert_array_equal(seen[14:34], 0)  # out of sight
    np.testing.assert_allclose(seen[34:39], [1, 4 / 9, 0, -4 / 9, 15 / 45], rtol=1e-6)
    np.testing.assert_array_equal(seen[39:44], 0)  # agent_2 is dead
    np.testing.assert_allclose(seen[54], 30 / 45, rtol=1e-6)
    np.testing.assert_array_equal(seen[55:], [0, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0])


def test_an_agents_fellows_leave_itself_out():
    env = battle(agents=[(9.0, 12.0 + i) for i in range(AGENTS)])
    for me, seen in enumerate(env.observe()):
        above = [9 * row[3] for row in seen[0, 34:54].reshape(4, 5)]
        np.testing.assert_allclose(above, [i - me for i in range(AGENTS) if i != me], atol=1e-6)


def test_the_dead_see_nothing_and_have_the_no_op_alone():
    env = battle(health={3: 0})
    seen = env.observe()[3][0]
    np.testing.assert_array_equal(seen[:55], 0)
    np.testing.assert_array_equal(seen[55:], [1, *[0] * 11])
    assert all(mask[0, NO_OP] == 0 for i, mask in enumerate(masks_of(env)) if i != 3)


def test_targets_are_offered_up_to_six_cells_and_while_they_live():
    near, far = (9.0 + 6.0, 12.0), (9.0 + 6.0 + 1 / GRID, 12.0)
    env = battle(enemies=[near, far, near, *CAMP[3:]], health={AGENTS + 2: 0})
    np.testing.assert_array_equal(masks_of(env)[0][0, 6:], [1, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("place", "closed"),
    [((0.9, 16), WEST), ((31.1, 16), EAST), ((9, 8.9), SOUTH), ((9, 23.1), NORTH)],
)
def test_the_arena_ends_where_the_maps_open_ground_does(place, closed):
    env = battle(agents=[place, *HOME[1:]])
    expected = [0 if move == closed else 1 for move in (NORTH, SOUTH, EAST, WEST)]
    np.testing.assert_array_equal(masks_of(env)[0][0, 2:6], expected)


def test_a_move_covers_half_a_second_of_a_marines_speed():
    env = battle()
    before = places_of(env)
    play(env, SOUTH, NORTH, EAST, WEST, STOP)
    moved = (places_of(env) - before)[:AGENTS]
    length = 2.25 / 2
    np.testing.assert_array_equal(
        moved, [(0, -length), (0, length), (length, 0), (-length, 0), (0, 0)]
    )


def test_enemies_that_see_nobody_march_on_the_agents_start():
    env = battle(agents=[(2.0, 9.0 + i) for i in range(AGENTS)], enemies=[(30.0, 16.0)] * ENEMIES)
    play(env)
    # Half a second along the way to (9, 16), and not towards the agents.
    np.testing.assert_array_equal(places_of(env)[AGENTS:], [(30 - 2.25 / 2, 16)] * ENEMIES)


def test_enemies_come_into_reach_of_the_nearest_agent_and_shoot_it():
    env = battle(enemies=[(9.0 + 8.0, 12.0), *CAMP[1:]])
    for _ in range(3):
        play(env)
    gap = places_of(env)[AGENTS, 0] - 9.0
    assert 5.75 - 2.25 / 16 < gap <= 5.75
    assert health_of(env)[0] == 45 - 6
    assert (health_of(env)[1:AGENTS] == 45).all()


def test_shots_come_every_14_loops_of_which_a_step_has_8():
    """Shots in loops 0, 14, 28, 42, 56: in steps 0, 1, 3, 5, 7."""
    env = battle(enemies=[(14.0, 12.0), *CAMP[1:]], health={0: 1e6})
    dealt = []
    for _ in range(8):
        before = health_of(env)[AGENTS]
        outcome = play(env, attack(0))
        dealt.append(before - health_of(env)[AGENTS])
        assert outcome.rewards[0][0] == pytest.approx(dealt[-1] * 20 / 530, rel=1e-6)
    assert dealt[:7] == [6, 6, 0, 6, 0, 6, 0]
    assert dealt[7] == 6


def test_a_target_beyond_reach_is_approached_first():
    env = battle(enemies=[(14.9, 12.0), *CAMP[1:]], cooldown={AGENTS: 100})
    play(env, attack(0))
    assert health_of(env)[AGENTS] == 39
    assert 9.1 < places_of(env)[0, 0] < 9.3


def test_those_who_move_or_wait_do_not_shoot():
    env = battle(enemies=[(14.0, 12.0), *CAMP[1:]], health={0: 1e6})
    for order in (STOP, NORTH, SOUTH):
        outcome = play(env, order)
        assert outcome.rewards[0][0] == 0
    assert health_of(env)[AGENTS] == 45


def test_a_kill_pays_ten_and_what_was_left_to_hit():
    env = battle(enemies=[(14.0, 12.0), *CAMP[1:]], health={AGENTS: 4})
    outcome = play(env, attack(0))
    assert outcome.rewards[0][0] == pytest.approx((4 + 10) * 20 / 530, rel=1e-6)
    assert not outcome.terminated[0]
    assert not env.success[0]
    outcome = play(env)
    assert outcome.rewards[0][0] == 0  # paid once


def test_the_last_kill_wins_and_pays_the_dead_too():
    dead = {AGENTS + i: 0 for i in range(1, ENEMIES)} | {4: 0}
    env = battle(enemies=[(14.0, 12.0), *CAMP[1:]], health={AGENTS: 6, **dead})
    outcome = play(env, attack(0))
    assert [float(reward[0]) for reward in outcome.rewards] == pytest.approx(
        [(6 + 10 + 200) * 20 / 530] * AGENTS, rel=1e-6
    )
    assert outcome.terminated[0]
    assert not outcome.truncated[0]
    assert env.success[0]


def test_who_dies_with_the_last_enemy_has_not_won():
    dead = {i: 0 for i in range(UNITS) if i not in (0, AGENTS)}
    env = battle(enemies=[(14.0, 12.0), *CAMP[1:]], health={**dead, 0: 6, AGENTS: 6})
    outcome = play(env, attack(0))
    assert outcome.terminated[0]
    assert not env.success[0]
    assert outcome.rewards[0][0] == pytest.approx((6 + 10) * 20 / 530, rel=1e-6)


def test_a_lost_battle_ends():
    dead = dict.fromkeys(range(1, AGENTS), 0)
    env = battle(enemies=[(14.0, 12.0), *CAMP[1:]], health={**dead, 0: 6})
    outcome = play(env, STOP)
    assert outcome.terminated[0]
    assert not env.success[0]
    np.testing.assert_array_equal(env.observe()[0][0], [0] * 55 + [1] + [0] * 11)


def test_a_won_battle_returns_20_however_it_was_won():
    env = battle(health=dict.fromkeys(range(AGENTS), 1000000000.0))
    total = 0.0
    for _ in range(70):
        masks = masks_of(env)
        orders = [
            attack(int(mask[0, 6:].argmax())) if mask[0, 6:].any() else EAST for mask in masks
        ]
        outcome = play(env, *orders)
        total += float(outcome.rewards[2][0])
        if outcome.terminated[0]:
            break
    assert env.success[0]
    assert total == pytest.approx(20, abs=1e-4)


def test_the_limit_truncates():
    env = battle(elapsed=68)
    assert not play(env).truncated[0]
    outcome = play(env)
    assert outcome.truncated[0]
    assert not outcome.terminated[0]


def test_units_that_overlap_are_pushed_apart_by_half_each_and_stay_inside():
    env = battle(agents=[(5.0, 16.0), (5.25, 16.0), (0.4, 20.0), (0.4, 20.25), (9.0, 12.0)])
    play(env)
    places = places_of(env)
    np.testing.assert_array_equal(places[:2], [(4.75, 16), (5.5, 16)])
    assert np.linalg.norm(places[2] - places[3]) == pytest.approx(0.75, abs=0.01)
    assert places[2, 0] == 0.4


def test_same_seeds_and_actions_same_bytes_at_any_number_of_copies():
    seeds = np.array([11, 5, 2**62, 7])
    many, random = registry.make("5m_vs_6m", 4), np.random.default_rng(0)
    many.reset(np.arange(4), seeds)
    singles = [registry.make("5m_vs_6m", 1) for _ in seeds]
    for env, seed in zip(singles, seeds, strict=True):
        env.reset(np.array([0]), np.array([seed]))
    for _ in range(40):
        actions = random_actions(many, random)
        ours = many.step(actions)
        for copy, env in enumerate(singles):
            theirs = env.step([action[copy : copy + 1] for action in actions])
            assert many.state()[copy].tobytes() == env.state()[0].tobytes()
            assert ours.rewards[0][copy] == theirs.rewards[0][0]
            for mine, other in zip(many.observe(), env.observe(), strict=True):
                assert mine[copy].tobytes() == other[0].tobytes()


def test_a_battle_goes_on_exactly_from_its_state():
    env, random = registry.make("5m_vs_6m", 3), np.random.default_rng(1)
    env.reset(np.arange(3), np.arange(3))
    for _ in range(12):
        env.step(random_actions(env, random))
    kept = env.state()
    actions, first = [], []
    for _ in range(2):
        actions.append(random_actions(env, random))
        first.append(env.step(actions[-1]))
    end = env.state()
    other = registry.make("5m_vs_6m", 3)
    other.set_state(kept)
    for action, expected in zip(actions, first, strict=True):
        outcome = other.step(action)
        np.testing.assert_array_equal(outcome.rewards[0], expected.rewards[0])
        np.testing.assert_array_equal(outcome.terminated, expected.terminated)
    assert other.state().tobytes() == end.tobytes()
    with pytest.raises(ValueError, match="state has shape"):
        other.set_state(kept[:2])


def test_another_seed_is_another_battle():
    env = registry.make("5m_vs_6m", 2)
    env.reset(np.arange(2), np.array([1, 2]))
    assert not np.array_equal(*env.state())


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (NO_OP, r"agent_1 cannot take action 0 in copy 1: available are \[1, 2, 3, 4, 5\]"),
        (attack(0), "agent_1 cannot take action 6 in copy 1"),
        (12, "agent_1 cannot take action 12 in copy 1"),
        (-1, "agent_1 cannot take action -1 in copy 1"),
        (1.5, r"agent_1 cannot take action 1.5 in copy 1"),
        (np.nan, "agent_1 cannot take action nan in copy 1"),
    ],
)
def test_an_action_that_is_not_available_is_refused_before_anything_moves(action, message):
    env = battle(copies=2)
    before = env.state()
    actions = [np.full((2, 1), STOP, np.float32) for _ in range(AGENTS)]
    actions[1][1] = action
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert env.state().tobytes() == before.tobytes()


def test_actions_of_other_shapes_are_refused():
    env = battle()
    good = [np.full((1, 1), STOP, np.float32)] * AGENTS
    with pytest.raises(ValueError, match="4 actions for 5 agents"):
        env.step(good[:4])
    with pytest.raises(ValueError, match="the action of agent_4 has shape"):
        env.step([*good[:4], np.ones((1, 2), np.float32)])
    with pytest.raises(ValueError, match="at least one copy"):
        registry.make("5m_vs_6m", 0)
