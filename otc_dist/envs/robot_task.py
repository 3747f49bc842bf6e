"""What the robots are to do, as a function of what one agent sees: for planning in a model.

Operators that NumPy arrays and torch tensors share; no simulator and no torch here.
"""

from dataclasses import dataclass
from typing import Any

from otc_dist.envs.robot_specs import PARTITIONS, Robot


@dataclass(frozen=True)
class RobotTask:
    """Reward and end of an episode, estimated from s, a_i and s' of one agent, a `Task`.

    The forward position is not observed, so the forward velocity of the step is taken to be the
    mean of the observed torso velocities before and after it. Other agents' actions are unknown
    to an agent, so the control cost is that of its own.
    """

    robot: Robot

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        """(v(s) + v(s')) / 2 + healthy reward - control cost (...), v in m/s."""
        forward = self.robot.joints - 1  # qvel[0] follows qpos[1:]
        velocity = (observation[..., forward] + next_observation[..., forward]) / 2
        cost = self.robot.control_cost * (action * action).sum(-1)
        return velocity + self.robot.healthy_reward - cost

    def terminated(self, next_observation: Any) -> Any:
        """Whether the robot has fallen (...), bool; what is not a number has fallen."""
        height, angle, health = (
            next_observation[..., 0],
            next_observation[..., 1],
            self.robot.health,
        )
        if health is None:
            return height != height  # never, but in a shape that both libraries know
        healthy = (height > health.height[0]) & (height < health.height[1])
        healthy = healthy & (angle > health.angle[0]) & (angle < health.angle[1])
        if health.limit is not None:
            healthy = healthy & (abs(next_observation[..., 1:]) < health.limit).all(-1)
        return ~healthy


def task(env_id: str) -> RobotTask:
    """The task of a robot environment. Raises KeyError for an unknown id."""
    return RobotTask(PARTITIONS[env_id][0])
