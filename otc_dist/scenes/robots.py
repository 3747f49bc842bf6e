"""How a robot looks: the capsules of its MuJoCo model, where its joints put them."""

import math

import mujoco
import numpy as np

from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.envs.robots import load_model
from otc_dist.scenes.scene import NOBODYS, Body, Capsule, Frames, Point, View, agent_colour
from otc_dist.transitions import Float64


class RobotScene:
    """A robot's links, each in the colour of the agent that moves its joint.

    u is MuJoCo's x, v its z; angles are about -y. `model` is the robot's; its body n + 1 is
    `bodies[n]`.
    """

    def __init__(self, env_id: str) -> None:
        robot, agents = PARTITIONS[env_id]
        self._joints = robot.joints
        self.model = model = load_model(robot)
        self._data = mujoco.MjData(model)
        owners = {
            int(model.jnt_bodyid[model.actuator_trnid[actuator, 0]]): actuator * agents // model.nu
            for actuator in range(model.nu)
        }
        self.bodies = tuple(
            Body(
                model.body(number).name,
                agent_colour(owners[number]) if number in owners else NOBODYS,
                tuple(_capsules(model, number)),
            )
            for number in range(1, model.nbody)
        )
        self.view = View((0.4, 0.8), 3.6, 2.2, follows=0)
        self.choices = ()
        self.seconds = float(model.opt.timestep) * robot.frame_skip

    @property
    def top(self) -> float:
        """How high the robot reaches where an episode begins, m."""
        poses = self.frames(np.hstack(([0.0], self.model.qpos0))[None]).poses[0]
        return max(
            float(v + math.sin(angle) * a + math.cos(angle) * b + capsule.radius)
            for body, (_, v, angle) in zip(self.bodies, poses, strict=True)
            for capsule in body.capsules
            for a, b in (capsule.start, capsule.end)
        )

    def frames(self, states: Float64) -> Frames:
        """See `Scene.frames`; a state is the elapsed steps, qpos, qvel and the warm start."""
        model, data, count = self.model, self._data, len(self.bodies)
        poses = np.full((len(states), count, 3), np.nan)
        positions = self.positions(states)
        for t in np.flatnonzero(np.isfinite(positions).all(axis=1)):
            data.qpos[:] = positions[t]
            mujoco.mj_kinematics(model, data)
            poses[t, :, 0] = data.xpos[1:, 0]
            poses[t, :, 1] = data.xpos[1:, 2]
            # The links' own x axes are (cos, 0, sin) of the angle.
            poses[t, :, 2] = np.arctan2(data.xmat[1:, 6], data.xmat[1:, 0])
        return Frames(poses, np.ones((len(states), count)))

    def positions(self, states: Float64) -> Float64:
        """Where the joints of the model are in `states` (T, state_size): its qpos, (T, nq)."""
        return states[:, 1 : 1 + self._joints]


def _capsules(model: mujoco.MjModel, body: int) -> list[Capsule]:
    found = []
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] != body:
            continue
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_CAPSULE:
            raise ValueError(f"{model.geom(geom).name!r} is not a capsule")
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        radius, half = (float(size) for size in model.geom_size[geom, :2])
        x, _, z = (float(at) for at in model.geom_pos[geom])
        along = (half * float(rotation[2]), half * float(rotation[8]))  # its own z axis
        start: Point = (x - along[0], z - along[1])
        end: Point = (x + along[0], z + along[1])
        found.append(Capsule(start, end, radius))
    return found
