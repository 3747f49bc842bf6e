"""Data of uniformly random policies, the only level of the particle tasks, with 10^6 transitions as
in the paper, and of a user's own environment, whose speed nobody knows, with 10^5.
"""

from otc_dist.datasets.source import Behaviour, Uniform
from otc_dist.envs import particle_family, pettingzoo_adapter, registry

LEVELS = ("random",)
TRANSITIONS = 1_000_000
OWN_TRANSITIONS = 100_000


class RandomSource:
    """The `Source` of the particle tasks and of the user's own."""

    packages: tuple[str, ...] = ()

    def offers(self, env_id: str) -> bool:
        return particle_family.knows(env_id) or pettingzoo_adapter.knows(env_id)

    def levels(self, env_id: str) -> tuple[str, ...]:
        return LEVELS

    def usual_size(self, env_id: str, level: str) -> int:
        return TRANSITIONS if particle_family.knows(env_id) else OWN_TRANSITIONS

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        return ("uniform",)

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        return Uniform(registry.team_spec(env_id))

    def seed_name(self, env_id: str) -> str:
        return env_id

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        return pettingzoo_adapter.versions(env_id) if pettingzoo_adapter.knows(env_id) else {}
