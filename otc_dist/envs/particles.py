"""Points that move in a square, batched: the paper's variant of the multi-agent particle tasks.

The particles are kinematic: an agent's action is its velocity, two numbers in [-0.1, 0.1] a step.
What the paper leaves open is decided here:

- The arena is [-1, 1]^2, where the particle environments (Lowe et al. 2017) place everything.
  Positions are clipped to it: without walls a faster prey could never be caught, and greedy
  policies could leave the region of the data for good.
- An episode has 25 steps, as there: enough to cross the arena at full speed.
- Every agent observes all positions, its teammates' included, in one order that never changes, so
  that each learner knows its own place in it; agents share no parameters that would make an order
  of their own necessary. Nothing but positions determines what follows, so a task is Markov for
  the team as a whole.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.envs.base import JointActions, Outcome, at_least_one
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.transitions import Bool, Float32, Float64

MAX_EPISODE_STEPS = 25
MAX_SPEED = 0.1  # of an agent, along each axis, a step


def particle_team(env_id: str, agents: int, others: int, speed: float = MAX_SPEED) -> TeamSpec:
    """The team of a task of `agents` agents and `others` other points."""
    points = agents + others
    return TeamSpec(
        env_id=env_id,
        agents=tuple(
            AgentSpec(f"agent_{i}", 2 * points, (-speed, -speed), (speed, speed))
            for i in range(agents)
        ),
        state_size=1 + 2 * points,
        max_episode_steps=MAX_EPISODE_STEPS,
    )


def squared_distances(agents: Any, others: Any) -> Any:
    """(..., M, N) for positions (..., N, 2) and (..., M, 2), as NumPy arrays or torch tensors."""
    apart = others[..., :, None, :] - agents[..., None, :, :]
    apart = apart * apart
    return apart[..., 0] + apart[..., 1]


def positions(observation: Any, agents: int) -> tuple[Any, Any]:
    """Positions of the agents (..., N, 2) and of the others (..., M, 2) in an observation."""
    points = observation.reshape(*observation.shape[:-1], -1, 2)
    return points[..., :agents, :], points[..., agents:, :]


def never(observation: Any) -> Any:
    """False (...), in a shape and kind that NumPy and torch share."""
    return observation[..., 0] != observation[..., 0]


class Particles:
    """E copies of points in a square: the part of a `BatchedEnv` that all particle tasks share.

    Positions are float32, like the observations, which therefore give the whole state. A reset
    places all points uniformly at random in the arena.

    Raises:
        ValueError: fewer than one copy.
    """

    def __init__(self, spec: TeamSpec, copies: int) -> None:
        self.spec, self.copies = spec, at_least_one(copies)
        count = len(spec.agents)
        self._flat = np.zeros((copies, spec.agents[0].observation_size), np.float32)
        points = self._flat.reshape(copies, -1, 2)
        self._agents, self._others = points[:, :count], points[:, count:]  # (E, N, 2), (E, M, 2)
        self._moving = self._flat[:, : 2 * count]  # the agents' part as rows, like actions
        self._elapsed = np.zeros(copies, np.int64)
        self._actions = JointActions(spec, copies)

    def reset(self, which: NDArray[np.int64], seeds: NDArray[np.int64]) -> None:
        """See `BatchedEnv.reset`."""
        for copy, seed in zip(which.tolist(), seeds.tolist(), strict=True):
            self._begin(copy, np.random.default_rng(seed))
        self._elapsed[which] = 0

    def _begin(self, copy: int, random: np.random.Generator) -> None:
        """Draw the initial state of a copy."""
        self._flat[copy] = random.uniform(-1.0, 1.0, self._flat.shape[1])

    def observe(self) -> tuple[Float32, ...]:
        """See `BatchedEnv.observe`: positions (x, y) of the agents and then of the other points."""
        return (self._flat.copy(),) * len(self.spec.agents)

    def step(self, actions: Sequence[Float32]) -> Outcome:
        """See `BatchedEnv.step`."""
        self._move(self._actions.clipped(actions))
        # Not np.clip: it takes longer than the two together.
        np.maximum(self._flat, -1.0, out=self._flat)
        np.minimum(self._flat, 1.0, out=self._flat)
        self._elapsed += 1
        reward, terminated = self._judge()
        truncated = self._elapsed >= MAX_EPISODE_STEPS
        return Outcome((reward,) * len(self.spec.agents), terminated, truncated & ~terminated)

    def _move(self, velocities: Float32) -> None:
        """Move all points that move; agents by `velocities` (E, 2N)."""
        self._moving += velocities

    def _judge(self) -> tuple[Float32, Bool]:
        """The team's reward (E,) in the state that was reached, and whether the task ended (E,)."""
        raise NotImplementedError

    def state(self) -> Float64:
        """See `BatchedEnv.state`: elapsed steps, positions."""
        return np.concatenate((self._elapsed[:, None], self._flat), axis=1, dtype=np.float64)

    def set_state(self, state: Float64) -> None:
        """See `BatchedEnv.set_state`. Raises ValueError for another shape."""
        if state.shape != (self.copies, self.spec.state_size):
            raise ValueError(
                f"the state has shape {state.shape}, not {(self.copies, self.spec.state_size)}"
            )
        self._elapsed[...] = state[:, 0]
        self._flat[...] = state[:, 1 : 1 + self._flat.shape[1]]

    def close(self) -> None:
        """Nothing to release."""
