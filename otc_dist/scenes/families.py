"""Scenes by environment. A new family of tasks that can be drawn is one more case in `find`."""

from otc_dist.envs import particle_family, robot_specs, skirmish
from otc_dist.scenes.scene import Scene
from otc_dist.spec import TeamSpec


def find(team: TeamSpec) -> Scene | None:
    """What a team's environment looks like; None if its states do not say.

    Nor do they if the environment is unknown, or was another one when it was logged. The family's
    simulator is imported only if it is needed to know where its bodies are.
    """
    env_id = team.env_id
    if env_id in robot_specs.PARTITIONS and robot_specs.team_spec(env_id) == team:
        from otc_dist.scenes.robots import RobotScene

        return RobotScene(env_id)
    if particle_family.knows(env_id) and particle_family.team_spec(env_id) == team:
        from otc_dist.scenes.particles import ParticleScene

        return ParticleScene(env_id)
    if env_id in skirmish.SKIRMISHES and skirmish.team_spec(env_id) == team:
        from otc_dist.scenes.skirmish import SkirmishScene

        return SkirmishScene(env_id)
    return None
