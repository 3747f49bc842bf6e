"""Offline data of skirmishes.

- `medium`: battles that the native skirmish's medium policy fought, 10,000 of them as in the
  paper. All agents act by one network, each on its own observation, and sample from its softmax,
  which is nearly deterministic: the paper's behaviour policies are "very deterministic".
- `random`: uniform among what is available.
"""

from collections.abc import Sequence

import numpy as np

from otc_dist.datasets.behaviour import BehaviourPolicy, load_card, load_policy
from otc_dist.datasets.source import Behaviour, Uniform
from otc_dist.envs import registry
from otc_dist.envs.skirmish import SKIRMISHES
from otc_dist.transitions import Float32

TRANSITIONS = 234_224  # of the medium policy's first 10,000 episodes


class SkirmishSource:
    """The `Source` of the skirmish."""

    packages: tuple[str, ...] = ()

    def offers(self, env_id: str) -> bool:
        return env_id in SKIRMISHES

    def levels(self, env_id: str) -> tuple[str, ...]:
        return ("random", "medium")

    def usual_size(self, env_id: str, level: str) -> int:
        return TRANSITIONS

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        return (level,)

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        team = registry.team_spec(env_id)
        if policy == "random":
            return Uniform(team)
        return _SharedPolicy(load_policy(env_id, load_card(env_id).medium), len(team.agents))

    def seed_name(self, env_id: str) -> str:
        return env_id

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        if level == "random":
            return {}
        return {"policy medium": load_card(env_id).medium.sha256}


class _SharedPolicy:
    """Agents that act by one policy, each on what it sees."""

    def __init__(self, policy: BehaviourPolicy, agents: int) -> None:
        self._policy, self._agents = policy, agents

    def noise(self, random: np.random.Generator, steps: int) -> Float32:
        return self._policy.noise(random, steps * self._agents).reshape(steps, -1)

    def act(self, observations: Sequence[Float32], noise: Float32) -> Sequence[Float32]:
        # One row per agent and copy, agent by agent.
        by_row = np.concatenate(np.split(noise, self._agents, axis=1))
        actions = self._policy.act(np.concatenate(observations), by_row)
        return np.split(actions, self._agents)
