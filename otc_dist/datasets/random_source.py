"""Data of uniformly random policies, the particle tasks' only level: 10^6 transitions, as in the
paper.
"""

from otc_dist.datasets.source import Behaviour, Uniform
from otc_dist.envs import particle_family, registry

LEVELS = ("random",)
TRANSITIONS = 1_000_000


class RandomSource:
    """The `Source` of the particle tasks."""

    packages: tuple[str, ...] = ()

    def offers(self, env_id: str) -> bool:
        return particle_family.knows(env_id)

    def levels(self, env_id: str) -> tuple[str, ...]:
        return LEVELS

    def usual_size(self, env_id: str, level: str) -> int:
        return TRANSITIONS

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        return ("uniform",)

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        return Uniform(registry.team_spec(env_id))

    def seed_name(self, env_id: str) -> str:
        return env_id

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        return {}
