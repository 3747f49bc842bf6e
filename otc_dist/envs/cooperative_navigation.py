"""Cooperative Navigation: N agents cover N landmarks (the paper's appendix).

Landmarks stand still. Where all is placed, how far it goes and what is observed: `particles.py`.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from otc_dist.envs.particles import (
    Particles,
    never,
    particle_team,
    positions,
    squared_distances,
)
from otc_dist.spec import TeamSpec
from otc_dist.transitions import Bool, Float32


def team_spec(agents: int) -> TeamSpec:
    """N agents that observe N agents and N landmarks."""
    return particle_team(f"cooperative-navigation-{agents}", agents, agents)


class CooperativeNavigation(Particles):
    """E copies, a `BatchedEnv`; all agents are given r = - sum_j min_i |landmark_j - agent_i|."""

    def __init__(self, agents: int, copies: int) -> None:
        super().__init__(team_spec(agents), copies)
        self._endless: Bool = np.zeros(copies, np.bool_)

    def _judge(self) -> tuple[Float32, Bool]:
        squares = squared_distances(self._agents, self._others)  # (E, landmarks, agents)
        closest = np.sqrt(np.minimum.reduce(squares, axis=2))
        return -np.add.reduce(closest, axis=1), self._endless.copy()


@dataclass(frozen=True)
class CooperativeNavigationTask:
    """The same reward from what an agent observes, a `Task`."""

    agents: int

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        """- sum_j min_i |landmark_j - agent_i| (...) in s'."""
        squares = squared_distances(*positions(next_observation, self.agents))
        # NumPy and torch share no minimum along an axis, but the upper bound of `clip`.
        columns = (squares[..., agent] for agent in range(self.agents))
        closest = reduce(lambda smallest, column: smallest.clip(max=column), columns)
        return -(closest**0.5).sum(-1)

    def terminated(self, next_observation: Any) -> Any:
        """Never."""
        return never(next_observation)
