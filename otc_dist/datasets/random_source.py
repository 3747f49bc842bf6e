"""Data of uniformly random policies, the only level of the particle tasks, with 10^6 transitions as
in the paper, and of StarCraft II and a user's own environment, which may be slow, with 10^5.
"""

from otc_dist.datasets.source import Behaviour, Uniform
from otc_dist.envs import particle_family, pettingzoo_adapter, registry, smac_adapter

LEVELS = ("random",)
TRANSITIONS = 1_000_000
FOREIGN_TRANSITIONS = 100_000

_FAMILIES = (particle_family, smac_adapter, pettingzoo_adapter)


class RandomSource:
    """The `Source` of the particle tasks, of StarCraft II and of the user's own."""

    packages: tuple[str, ...] = ()

    def offers(self, env_id: str) -> bool:
        return any(family.knows(env_id) for family in _FAMILIES)

    def levels(self, env_id: str) -> tuple[str, ...]:
        return LEVELS

    def usual_size(self, env_id: str, level: str) -> int:
        return TRANSITIONS if particle_family.knows(env_id) else FOREIGN_TRANSITIONS

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        return ("uniform",)

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        return Uniform(registry.team_spec(env_id))

    def seed_name(self, env_id: str) -> str:
        return env_id

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        if smac_adapter.knows(env_id):
            return smac_adapter.versions()
        return pettingzoo_adapter.versions(env_id) if pettingzoo_adapter.knows(env_id) else {}
