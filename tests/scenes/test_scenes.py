"""Bodies are where the state says."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from otc_dist.envs import registry
from otc_dist.envs.skirmish_rules import GRID
from otc_dist.scenes.families import find
from otc_dist.scenes.robots import RobotScene
from otc_dist.scenes.scene import AGENT_COLOURS, FOE, NOBODYS, Body, Scene

ROBOTS = ("hopper-3x1", "halfcheetah-2x3", "walker2d-2x3", "hopper-1x3")


def states_of(env_id: str, steps: int = 6) -> np.ndarray:
    """What an environment logs of two copies that move at random, (T, copies, state_size)."""
    env, rng = registry.make(env_id, 2, 0.5), np.random.default_rng(0)
    env.reset(np.arange(2), np.array([3, 4]))
    states = []
    for _ in range(steps):
        states.append(env.state())
        if env.spec.agents[0].choices:
            masks = [seen[:, -env.spec.agents[0].choices :] for seen in env.observe()]
            actions = [
                np.array([[rng.choice(np.flatnonzero(row))] for row in mask], np.float32)
                for mask in masks
            ]
        else:
            actions = [
                rng.uniform(a.action_low, a.action_high, (2, a.action_size)).astype(np.float32)
                for a in env.spec.agents
            ]
        env.step(actions)
    env.close()
    return np.stack(states)


def scene_of(env_id: str) -> Scene:
    scene = find(registry.team_spec(env_id))
    assert scene is not None
    return scene


def colours(bodies: tuple[Body, ...]) -> dict[str, tuple[int, int, int]]:
    return {body.name: body.colour for body in bodies}


@pytest.mark.parametrize("env_id", ROBOTS)
def test_a_robots_capsules_are_where_mujoco_has_them(env_id: str) -> None:
    states, scene = states_of(env_id)[:, 1], scene_of(env_id)
    assert isinstance(scene, RobotScene)
    poses = scene.frames(states).poses
    model, data = scene.model, mujoco.MjData(scene.model)
    for state, frame in zip(states, poses, strict=True):
        data.qpos[:] = state[1 : 1 + model.nq]
        mujoco.mj_forward(model, data)
        for number, (body, (u, v, angle)) in enumerate(zip(scene.bodies, frame, strict=True)):
            geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == number + 1]
            assert len(geoms) == len(body.capsules) > 0
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            for geom, capsule in zip(geoms, body.capsules, strict=True):
                radius, half = model.geom_size[geom, :2]
                axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
                middle = data.geom_xpos[geom]
                assert abs(middle[1]) < 1e-12 and abs(axis[1]) < 1e-12  # it is flat
                assert capsule.radius == radius
                for end, way in ((capsule.start, -1), (capsule.end, 1)):
                    found = turn @ end + (u, v)
                    assert np.allclose(found, (middle + way * half * axis)[[0, 2]], atol=1e-12)


def test_a_link_has_the_colour_of_the_agent_that_moves_it() -> None:
    assert colours(scene_of("hopper-3x1").bodies) == {
        "torso": NOBODYS,
        "thigh": AGENT_COLOURS[0],
        "leg": AGENT_COLOURS[1],
        "foot": AGENT_COLOURS[2],
    }
    walker = colours(scene_of("walker2d-2x3").bodies)
    assert walker["leg"] == AGENT_COLOURS[0] and walker["leg_left"] == AGENT_COLOURS[1]


def test_a_robot_whose_simulator_broke_off_is_nowhere() -> None:
    states = states_of("hopper-3x1")[:, 0].copy()
    states[2, 3] = np.nan
    poses = scene_of("hopper-3x1").frames(states).poses
    assert np.isnan(poses[2]).all() and np.isfinite(np.delete(poses, 2, axis=0)).all()


def test_a_step_of_a_robot_takes_as_long_as_the_tasks() -> None:
    assert scene_of("hopper-3x1").seconds == 0.008
    assert scene_of("halfcheetah-2x3").seconds == 0.05


@pytest.mark.parametrize(
    ("env_id", "names"),
    [
        ("predator-prey-3", ["agent_0", "agent_1", "agent_2", "prey"]),
        ("cooperative-navigation-2", ["agent_0", "agent_1", "landmark_0", "landmark_1"]),
        ("navigation", ["landmark", "agent_0"]),
    ],
)
def test_particles_are_where_they_are_observed(env_id: str, names: list[str]) -> None:
    env, scene = registry.make(env_id, 2, 0.5), scene_of(env_id)
    env.reset(np.arange(2), np.array([1, 2]))
    poses, levels = scene.frames(env.state())
    assert [body.name for body in scene.bodies] == names
    points = env.observe()[0].reshape(2, -1, 2)
    assert np.array_equal(poses[:, len(names) - points.shape[1] :, :2].astype(np.float32), points)
    assert (levels == 1).all() and (poses[..., 2] == 0).all()
    if env_id == "navigation":
        assert (poses[:, 0] == 0).all()  # the landmark, which the agent sees itself from


def test_units_of_a_skirmish_pale_and_go() -> None:
    scene = scene_of("5m_vs_6m")
    states = states_of("5m_vs_6m", 3)[:, 0].copy()
    units = 11
    states[1, 1 + 2 * units] = 22.5  # agent_0's health
    states[2, 1 + 2 * units] = 0
    poses, levels = scene.frames(states)
    assert levels[:, 0].tolist() == [1, 0.5, 0] and (levels[:, 1:] == 1).all()
    assert np.array_equal(poses[0, :, 0] * 8 * GRID, states[0, 1 : 1 + units])
    assert np.array_equal(poses[0, :, 1] * 8 * GRID, states[0, 1 + units : 1 + 2 * units])
    assert [body.colour for body in scene.bodies[5:]] == [FOE] * 6
    (left, bottom), *_, (_, top) = scene.view.outline
    assert (poses[..., 0] > left).all() and (bottom < poses[..., 1]).all()
    assert (poses[..., 1] < top).all()


def test_every_usual_environment_can_be_drawn_and_has_no_name_twice() -> None:
    for env_id in registry.env_ids():
        scene = scene_of(env_id)
        assert len(colours(scene.bodies)) == len(scene.bodies)
        assert scene.frames(states_of(env_id, 2)[:, 0]).poses.shape == (2, len(scene.bodies), 3)


def test_others_cannot() -> None:
    """Nor one that was another when it was logged: its states would be misread."""
    hopper = registry.team_spec("hopper-3x1")
    assert find(replace(hopper, env_id="smac/3m")) is None
    assert find(replace(hopper, env_id="no-such-task")) is None
    assert find(replace(hopper, state_size=20)) is None
