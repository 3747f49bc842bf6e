"""The robots by environment id: `hopper-3x1`, `halfcheetah-6x1` and the like."""

from otc_dist.envs import robot_specs, robot_task
from otc_dist.envs.base import BatchedEnv
from otc_dist.envs.family import Family


def _make(env_id: str, copies: int, progress: float | None) -> BatchedEnv:
    from otc_dist.envs.robots import RobotEnv  # MuJoCo

    del progress  # robots stay as they are
    return RobotEnv(env_id, copies)


FAMILY = Family(
    robot_specs.PARTITIONS.__contains__,
    robot_specs.team_spec,
    _make,
    usual=tuple(robot_specs.PARTITIONS),
    reference_returns=robot_specs.reference_returns,
    task=robot_task.task,
    states_of=robot_specs.states_of,
)
