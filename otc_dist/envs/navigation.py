"""Navigation: one agent, whose dynamics change between the data and the deployments (the paper's
non-stationary single-agent case).

The agent's velocity is beta a. In offline data, beta is drawn for each episode, uniformly from
[-0.2, 0.2]: the same action leads anywhere, and no direction is worth more than its opposite. In
the deployments and evaluations beta moves evenly from 0.1 to 0.2, from the first to the last.
Reaching the landmark brings 10 and ends the episode. The paper leaves open, and here:

- An action is in [-1, 1] along each axis, so that speeds are up to 0.1 to 0.2, those of the other
  particle tasks.
- The landmark is in the centre of the arena, and the agent, placed uniformly at random, observes
  its own position relative to it. With two numbers for a state, the transitions of one deployment
  lie close enough to those of the data to be compared with them.
- The landmark is reached below a distance of 0.1, where agents collide with the prey in
  Predator-Prey.
- beta is part of the state but not observed: an agent that saw it could distinguish the data.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from otc_dist.envs.particles import Particles, particle_team
from otc_dist.spec import TeamSpec
from otc_dist.transitions import Bool, Float32, Float64

ENV_ID = "navigation"
REWARD = 10.0
REACHED = 0.1
OFFLINE_BETA = (-0.2, 0.2)
ONLINE_BETA = (0.1, 0.2)  # in the first and in the last deployment


def team_spec() -> TeamSpec:
    """One agent that observes where it is; beta is one more number of the state."""
    team = particle_team(ENV_ID, 1, 0, speed=1.0)
    return replace(team, state_size=team.state_size + 1)


class Navigation(Particles):
    """E copies, a `BatchedEnv`; r = 10 where the landmark is reached.

    Args:
        progress: share of the deployments gone, from 0 to 1; None: offline data are made.
    """

    def __init__(self, copies: int, progress: float | None) -> None:
        super().__init__(team_spec(), copies)
        self._progress = progress
        self._beta = np.zeros((copies, 1), np.float32)

    def _begin(self, copy: int, random: np.random.Generator) -> None:
        super()._begin(copy, random)
        if self._progress is None:
            self._beta[copy] = random.uniform(*OFFLINE_BETA)
        else:
            first, last = ONLINE_BETA
            self._beta[copy] = first + (last - first) * self._progress

    def _move(self, velocities: Float32) -> None:
        super()._move(self._beta * velocities)

    def _judge(self) -> tuple[Float32, Bool]:
        reached: Bool = _reached(self._moving)
        return REWARD * reached.astype(np.float32), reached

    def state(self) -> Float64:
        """See `BatchedEnv.state`: elapsed steps, position, beta."""
        return np.concatenate((super().state(), self._beta), axis=1)

    def set_state(self, state: Float64) -> None:
        """See `BatchedEnv.set_state`."""
        super().set_state(state)
        self._beta[...] = state[:, -1:]


class NavigationTask:
    """The same reward and end from what the agent observes, a `Task`."""

    def reward(self, observation: Any, action: Any, next_observation: Any) -> Any:
        """10 (...) where s' is at the landmark."""
        return REWARD * self.terminated(next_observation)

    def terminated(self, next_observation: Any) -> Any:
        """Whether s' is at the landmark (...), bool."""
        return _reached(next_observation)


def _reached(position: Any) -> Any:
    """Whether a position (..., 2), as a NumPy array or torch tensor, is at the landmark."""
    squares = position * position
    return squares[..., 0] + squares[..., 1] < REACHED**2
