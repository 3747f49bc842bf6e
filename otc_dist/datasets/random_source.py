"""Data of uniformly random policies, where a family of environments has nothing else: the particle
tasks, StarCraft II, SMAX and a user's own environment.
"""

from otc_dist.datasets.source import Behaviour, Uniform
from otc_dist.envs import registry
from otc_dist.envs.family import RandomData

LEVELS = ("random",)


class RandomSource:
    """The `Source` of every family with `RandomData`."""

    packages: tuple[str, ...] = ()

    def offers(self, env_id: str) -> bool:
        return registry.random_data(env_id) is not None

    def levels(self, env_id: str) -> tuple[str, ...]:
        return LEVELS

    def usual_size(self, env_id: str, level: str) -> int:
        return _of(env_id).transitions

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        return (_of(env_id).policy,)

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        return Uniform(registry.team_spec(env_id))

    def seed_name(self, env_id: str) -> str:
        return env_id

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        return _of(env_id).recipe(env_id)


def _of(env_id: str) -> RandomData:
    found = registry.random_data(env_id)
    if found is None:
        raise KeyError(env_id)
    return found
