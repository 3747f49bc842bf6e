"""Scenes by environment. A new family of tasks that can be drawn is one more case in `find`."""

from otc_dist.envs import particle_family, robot_specs, skirmish
from otc_dist.scenes.scene import Scene


def find(env_id: str) -> Scene | None:
    """What the environment looks like; None if it is unknown or its states do not tell.

    The family's simulator is imported only if it is needed to know where its bodies are.
    """
    if env_id in robot_specs.PARTITIONS:
        from otc_dist.scenes.robots import RobotScene

        return RobotScene(env_id)
    if particle_family.knows(env_id):
        from otc_dist.scenes.particles import ParticleScene

        return ParticleScene(env_id)
    if env_id in skirmish.SKIRMISHES:
        from otc_dist.scenes.skirmish import SkirmishScene

        return SkirmishScene(env_id)
    return None
