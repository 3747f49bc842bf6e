"""Perfect correction: an agent's transitions as they would be with the others acting as now.

From the state of a recorded transition the recorded a_i is played again together with what the
other agents would do now, one step in the simulator; s', r and the end are what comes out. It needs
all agents' data and policies and a state to set, so only an analysis can do it.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from otc_dist.datasets.joint import JointTransitions
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32, Float64, Transitions

COPIES = 512  # steps simulated at once
TOLERANCE = 1e-3  # standard deviations by which a step played again may miss what was recorded

Rows = TypeVar("Rows", Float32, Float64)


class OneStepResult(NamedTuple):
    """What came out of N single steps. Tuples are indexed by agent."""

    rewards: tuple[Float32, ...]  # (N,)
    successors: tuple[Float32, ...]  # (N, s)
    ended: Bool  # (N,)


def possible(env_id: str) -> bool:
    """Whether the task's simulator can be set to an observed state."""
    size = registry.team_spec(env_id).agents[0].observation_size
    return registry.states_of(env_id, np.zeros((1, size), np.float32)) is not None


def check(env_id: str) -> None:
    """Raises UserError for a task whose simulator cannot be set to an observed state."""
    if not possible(env_id):
        raise UserError(
            "perfect correction needs a simulator whose state can be set from an observation, and"
            f" {env_id} has none: robots and particles have"
        )


class OneStep:
    """Single steps from observed states, by the simulator of one environment.

    Raises:
        UserError: see `check`.
    """

    def __init__(self, env_id: str) -> None:
        check(env_id)
        self._env_id = env_id
        self._env = registry.make(env_id, COPIES)
        self._env.reset(np.arange(COPIES), np.zeros(COPIES, np.int64))

    def play(self, observations: Float32, actions: Sequence[Float32]) -> OneStepResult:
        """One joint step from each state.

        Args:
            observations: of any one agent, (N, s).
            actions: of all agents, each (N, a).
        """
        states = registry.states_of(self._env_id, observations)
        assert states is not None  # checked
        agents = range(len(actions))
        rewards: list[list[Float32]] = [[] for _ in agents]
        successors: list[list[Float32]] = [[] for _ in agents]
        ended: list[Bool] = []
        for start in range(0, len(states), COPIES):
            rows = slice(start, start + COPIES)
            count = len(states[rows])
            self._env.set_state(_padded(states[rows]))
            outcome = self._env.step([_padded(action[rows]) for action in actions])
            seen = self._env.observe()
            for i in agents:
                rewards[i].append(outcome.rewards[i][:count])
                successors[i].append(seen[i][:count])
            ended.append(outcome.terminated[:count])
        return OneStepResult(
            tuple(map(np.concatenate, rewards)),
            tuple(map(np.concatenate, successors)),
            np.concatenate(ended),
        )


class Correction:
    """Recorded transitions of a team, to be played again with other actions.

    An observation may not show the whole state: the robots clip velocities. Where the recorded
    actions, played again, do not bring what was recorded, the difference that other actions make in
    the simulator is added to the record, within what is ever recorded.

    Attributes:
        missed: which transitions those are (N,).
    """

    def __init__(self, simulator: OneStep, recorded: JointTransitions) -> None:
        self._simulator, self._recorded = simulator, recorded
        self._again = simulator.play(recorded.observations[0], recorded.actions)
        self.missed = self._again.ended != recorded.terminated
        pairs = zip(self._again.successors, recorded.next_observations, strict=True)
        for again, before in pairs:
            error = np.abs(again - before) / (before.std(axis=0) + np.float32(1e-6))
            self.missed |= error.max(axis=1) > TOLERANCE

    def of_agent(self, agent: int, now: Sequence[Float32]) -> Transitions:
        """Agent number `agent`'s transitions (N) if the others had done `now`.

        Args:
            now: actions of all agents, each (N, a); the agent's own are not looked at, for it does
                what was recorded.
        """
        own, again, missed = self._recorded.of_agent(agent), self._again, self.missed
        actions = [own.actions if i == agent else action for i, action in enumerate(now)]
        found = self._simulator.play(own.observations, actions)
        rewards, successors = found.rewards[agent].copy(), found.successors[agent].copy()
        rewards[missed] += (own.rewards - again.rewards[agent])[missed]
        successors[missed] += (own.next_observations - again.successors[agent])[missed]
        low, high = own.next_observations.min(axis=0), own.next_observations.max(axis=0)
        successors[missed] = successors[missed].clip(low, high)
        unknown = again.ended != own.terminated
        ended = np.where(unknown, own.terminated, found.ended)
        return Transitions(
            own.observations, own.actions, rewards, successors, ended, own.truncated & ~ended
        )


def _padded(rows: Rows) -> Rows:
    """Rows (COPIES, n): where there are fewer, they are repeated."""
    return np.resize(rows, (COPIES, rows.shape[1]))
