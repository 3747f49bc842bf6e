"""Transitions: the one data type that flows from environments to logs, data sets and learners.

`JointStep` is what the env host sees (all agents), `Transitions` is what one agent may see
(its own), and `RowLayout` is how a learner keeps them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]


_FEW = 64


def all_finite(numbers: Float32) -> bool:
    """Whether no number is NaN or infinite: a sum of float32 in float64 never overflows."""
    if numbers.size <= _FEW:  # quicker
        return math.isfinite(sum(numbers.ravel().tolist()))
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        return math.isfinite(numbers.sum(dtype=np.float64))


@dataclass(frozen=True)
class Joint:
    """Transitions of a whole team: tuples are indexed by agent, arrays by transition."""

    observations: tuple[Float32, ...]  # N x (T, observation_size)
    actions: tuple[Float32, ...]  # N x (T, action_size), as the agents sent them
    rewards: tuple[Float32, ...]  # N x (T,)
    next_observations: tuple[Float32, ...]  # N x (T, observation_size), the true successors s'
    terminated: Bool  # (T,) the task ended here: V(s') = 0
    truncated: Bool  # (T,) a time limit ended the episode: V(s') is not 0
    # Both: the simulator broke off, and the step did not happen (`Transitions.sound`).

    def of_agent(self, index: int) -> "Transitions":
        """What agent `index` may see: its own transitions, and nothing of the others."""
        return Transitions(
            self.observations[index],
            self.actions[index],
            self.rewards[index],
            self.next_observations[index],
            self.terminated,
            self.truncated,
        )


@dataclass(frozen=True)
class JointStep(Joint):
    """One lock-step of E environment copies and N agents, as the env host sees and logs it.

    One transition a copy, T = E. `next_observations` are the true successors s', also where an
    episode ended and the copy was reset afterwards.
    """

    step: int
    exploring: tuple[bool, ...]  # N: behaviour tag, True where the agent explored
    episode_seeds: NDArray[np.int64]  # (E,) seed of the episode that this step belongs to
    state: Float64  # (E, state_size) simulator state before the step
    # Of a step in real time: N, True where the agent's answer was not there in time and its action
    # before was held; whether what the step brought came late. Of others there is nothing to say.
    held: tuple[bool, ...] = ()
    late: bool = False


@dataclass(frozen=True)
class Transitions:
    """N transitions <s, a_i, r, s'> of one agent, with their ends. s' is the true successor."""

    observations: Float32  # (N, observation_size)
    actions: Float32  # (N, action_size)
    rewards: Float32  # (N,)
    next_observations: Float32  # (N, observation_size)
    terminated: Bool  # (N,)
    truncated: Bool  # (N,)

    def __len__(self) -> int:
        return len(self.rewards)

    def __getitem__(self, rows: slice | NDArray[np.int64]) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    def sound(self) -> Self:
        """The rows without those of steps that did not happen: both terminated and truncated.

        That is how an environment says that its simulator broke off. In the place of such a row
        stands the one before it, or the first sound one, so that there are as many as before.

        Raises:
            ValueError: no step happened.
        """
        broken = self.terminated & self.truncated
        if not broken.any():
            return self
        (sound,) = (~broken).nonzero()
        if not len(sound):
            raise ValueError("the simulator broke off in every step")
        before = np.searchsorted(sound, np.arange(len(self)), side="right") - 1
        return self[sound[np.maximum(before, 0)]]

    @classmethod
    def concatenate(cls, parts: Sequence["Transitions"]) -> Self:
        """Join at least one part, in order."""
        return cls(
            *(np.concatenate([getattr(p, field.name) for p in parts]) for field in fields(cls))
        )


def choice_problem(data: Transitions, choices: int) -> str | None:
    """What is wrong with the masks and indices of discrete actions, in a few words; or None.

    Args:
        choices: number of discrete actions; 0: they are continuous, and nothing can be wrong.
    """
    if not choices:
        return None
    available, next_available = (
        data.observations[:, -choices:],
        data.next_observations[:, -choices:],
    )
    stuck = ~(available > 0).any(axis=1)
    stuck |= ~(next_available > 0).any(axis=1) & ~data.terminated
    if stuck.any():
        return f"the mask of row {int(stuck.argmax())} has no available action"
    action = data.actions[:, 0]
    index = np.clip(action, 0, choices - 1).astype(np.int64)
    wrong = (index != action) | (available[np.arange(len(data)), index] <= 0)
    if wrong.any():
        row = int(wrong.argmax())
        return f"action {action[row]:g} of row {row} is none of its available ones"
    return None


@dataclass(frozen=True)
class RowLayout:
    """Where each field lies in a packed float32 row: s | a_i | r | s' | terminated.

    One row is one contiguous gather, instead of five. With discrete actions (`choices`) the last
    `choices` entries of s and of s' are masks of the available ones.
    """

    observation_size: int
    action_size: int
    choices: int = 0

    @property
    def width(self) -> int:
        return 2 * self.observation_size + self.action_size + 2

    @property
    def observation(self) -> slice:
        return slice(0, self.observation_size)

    @property
    def action(self) -> slice:
        return slice(self.observation_size, self.observation_size + self.action_size)

    @property
    def reward(self) -> int:
        return self.observation_size + self.action_size

    @property
    def next_observation(self) -> slice:
        return slice(self.reward + 1, self.reward + 1 + self.observation_size)

    @property
    def terminated(self) -> int:
        return self.width - 1

    def pack(self, data: Transitions, rows: Float32 | None = None) -> Float32:
        """Transitions as rows (N, width), written to `rows` if they are given.

        Raises:
            ValueError: sizes that are not the layout's, a value that is not finite, or a discrete
                action that was not available.
        """
        if rows is None:
            rows = np.empty((len(data), self.width), dtype=np.float32)
        found = tuple(x.shape[1] for x in (data.observations, data.actions, data.next_observations))
        expected = (self.observation_size, self.action_size, self.observation_size)
        if found != expected:  # numpy would broadcast a size of one
            raise ValueError(f"sizes of s, a, s' are {found}, not {expected}")
        rows[:, self.observation] = data.observations
        rows[:, self.action] = data.actions
        rows[:, self.reward] = data.rewards
        rows[:, self.next_observation] = data.next_observations
        rows[:, self.terminated] = data.terminated
        if not all_finite(rows):
            raise ValueError("a transition holds a value that is not finite (NaN or infinity)")
        if problem := choice_problem(data, self.choices):
            raise ValueError(problem)
        return rows
