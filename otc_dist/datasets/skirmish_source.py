"""The skirmish's offline data: 10,000 battles fought by its medium policy, as in the paper.

All agents act by one network, each on its own observation, and sample from its softmax, which is
nearly deterministic: the paper's behaviour policies are "very deterministic".
"""

from collections.abc import Sequence

import numpy as np

from otc_dist.datasets.behaviour import BehaviourPolicy, load_card, load_policy
from otc_dist.datasets.source import Behaviour
from otc_dist.envs.skirmish import SKIRMISHES
from otc_dist.transitions import Float32

LEVELS = ("medium",)
TRANSITIONS = 234_224  # of the first 10,000 episodes


class SkirmishSource:
    """The `Source` of the skirmish."""

    packages: tuple[str, ...] = ()

    def offers(self, env_id: str) -> bool:
        return env_id in SKIRMISHES

    def levels(self, env_id: str) -> tuple[str, ...]:
        return LEVELS

    def usual_size(self, env_id: str, level: str) -> int:
        """As many as the first 10,000 episodes have."""
        return TRANSITIONS

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        return ("medium",)

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        return _Alike(load_policy(env_id, load_card(env_id).medium), SKIRMISHES[env_id].agents)

    def seed_name(self, env_id: str) -> str:
        return env_id

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        return {"policy medium": load_card(env_id).medium.sha256}


class _Alike:
    """Agents that act by one policy, each on what it sees."""

    def __init__(self, policy: BehaviourPolicy, agents: int) -> None:
        self._policy, self._agents = policy, agents

    def noise(self, random: np.random.Generator, steps: int) -> Float32:
        return self._policy.noise(random, steps * self._agents).reshape(steps, -1)

    def act(self, observations: Sequence[Float32], noise: Float32) -> Sequence[Float32]:
        # One row an agent and copy, agent by agent.
        draws = np.concatenate(np.split(noise, self._agents, axis=1))
        actions = self._policy.act(np.concatenate(observations), draws)
        return np.split(actions, self._agents)
