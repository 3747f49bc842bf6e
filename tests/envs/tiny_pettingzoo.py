"""A small PettingZoo environment whose every answer a test may change."""

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from pettingzoo import ParallelEnv

from otc_dist.envs import registry
from otc_dist.envs.base import BatchedEnv


class Tiny(ParallelEnv):
    """Two agents, episodes of five steps; a case changes one thing."""

    possible_agents: Any = ("left", "right")
    seen: Space[Any] = Box(-1, 1, (2,), np.float32)
    done: Space[Any] = Box(-1, 1, (1,), np.float32)
    length = 5

    def observation_space(self, agent: Any) -> Space[Any]:
        return dict.fromkeys(self.possible_agents, self.seen)[agent]

    def action_space(self, agent: Any) -> Space[Any]:
        return dict.fromkeys(self.possible_agents, self.done)[agent]

    def reset(self, seed: int | None = None, options: object = None) -> tuple[Any, Any]:
        self.agents, self.count = list(self.possible_agents), 0
        return self.look(), {}

    def look(self) -> Any:
        return dict.fromkeys(self.agents, np.full(2, self.count, np.float32))

    def ends(self) -> tuple[Any, Any]:
        return (
            dict.fromkeys(self.agents, False),
            dict.fromkeys(self.agents, self.count >= self.length),
        )

    def rewards(self) -> Any:
        return dict.fromkeys(self.agents, 1.0)

    def step(self, actions: Any) -> tuple[Any, ...]:
        self.sent = actions
        self.count += 1
        return (self.look(), self.rewards(), *self.ends(), {})


def case(**changed: Any) -> type[Tiny]:
    """The environment with some of its attributes changed."""
    return type("Case", (Tiny,), changed)


def begun(env_id: str, copies: int = 1) -> BatchedEnv:
    env = registry.make(env_id, copies)
    env.reset(np.arange(copies), np.arange(copies))
    return env


def played(env: BatchedEnv, steps: int) -> list[tuple[bool, bool]]:
    """How each step of one copy ended: terminated, truncated."""
    still = [np.zeros((env.copies, agent.action_size), np.float32) for agent in env.spec.agents]
    outcomes = [env.step(still) for _ in range(steps)]
    return [(bool(o.terminated[0]), bool(o.truncated[0])) for o in outcomes]
