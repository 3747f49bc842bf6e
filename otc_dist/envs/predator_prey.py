"""Predator-Prey: slower agents chase a faster prey that follows a rule (the paper's appendix).

An agent collides with the prey where their distance is below 0.1; for each agent that does, at
each step, all agents are given 1. The paper says of the prey that it is faster and rule-based.
Here:

- Its velocity lies in a square like the agents', 1.3 times as large: the ratio of the maximal
  speeds in the particle environments' `simple_tag`.
- While an agent is within 0.2, twice the distance of a collision, it flees straight away from the
  nearest one at full speed. Otherwise it returns to the centre of the arena.
- It moves at the same time as the agents, by the positions before the step.

The rule leaves something to learn from and something to learn. In the centre, uniformly random
agents run into the prey in about one episode of eight (mean return 0.2), so a data set of theirs
holds rewards; a prey that always flees is hit in one of two hundred. Three agents that head
straight for it reach 8, and one of them alone, which it outruns until it is cornered, 3.5.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from otc_dist.envs.particles import (
    MAX_SPEED,
    Particles,
    never,
    particle_team,
    positions,
    squared_distances,
)
from otc_dist.spec import TeamSpec
from otc_dist.transitions import Bool, Float32

COLLISION = 0.1
PREY_SPEED = 1.3 * MAX_SPEED  # along each axis, a step
PREY_SIGHT = 0.2


def team_spec(agents: int) -> TeamSpec:
    """N agents that observe N agents and one prey."""
    return particle_team(f"predator-prey-{agents}", agents, 1)


class PredatorPrey(Particles):
    """E copies, a `BatchedEnv`; all agents are given r = number of agents that collide."""

    def __init__(self, agents: int, copies: int) -> None:
        super().__init__(team_spec(agents), copies)
        self._prey = self._others[:, 0]  # (E, 2)
        self._everyone = np.arange(copies)
        self._endless: Bool = np.zeros(copies, np.bool_)

    def _move(self, velocities: Float32) -> None:
        flight = self._flight()
        super()._move(velocities)
        self._prey += flight

    def _flight(self) -> Float32:
        """The prey's velocity (E, 2) by its rule."""
        squares = squared_distances(self._agents, self._others)[:, 0]  # (E, N)
        nearest = squares.argmin(axis=1)
        seen = (squares[self._everyone, nearest] < PREY_SIGHT**2)[:, None]
        away = self._prey - self._agents[self._everyone, nearest]
        course = np.where(seen, away, -self._prey)
        length = np.abs(course).max(axis=1, keepdims=True)
        # At full speed, but no farther than the centre. An agent on top of it leaves it standing.
        farthest = np.where(seen, PREY_SPEED, np.minimum(length, PREY_SPEED))
        flight: Float32 = course * (farthest / np.maximum(length, np.finfo(np.float32).tiny))
        return flight

    def _judge(self) -> tuple[Float32, Bool]:
        squares = squared_distances(self._agents, self._others)[:, 0]
        colliding = squares < COLLISION**2
        return np.add.reduce(colliding, axis=1, dtype=np.float32), self._endless.copy()


@dataclass(frozen=True)
class PredatorPreyTask:
    """The same reward from what an agent observes, a `Task`."""

    agents: int

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        """The number of agents (...) that collide with the prey in s'."""
        squares = squared_distances(*positions(next_observation, self.agents))[..., 0, :]
        return (squares < COLLISION**2).sum(-1) * 1.0

    def terminated(self, next_observation: Any) -> Any:
        """Never."""
        return never(next_observation)
