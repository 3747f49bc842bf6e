"""The interface of every environment: E copies of one multi-agent task that step together."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from otc_dist.spec import TeamSpec
from otc_dist.transitions import Bool, Float32, Float64, all_finite


class Outcome(NamedTuple):
    """What one step of E copies and N agents brought. The arrays belong to the caller."""

    rewards: tuple[Float32, ...]  # N x (E,)
    terminated: Bool  # (E,)  the task ended
    truncated: Bool  # (E,)  the time limit was reached and the task had not ended
    # Both at once: the simulator broke off. This step did not happen, its episode does not count
    # and nobody learns from it (`Transitions.sound`); reset, the copy goes on.


class BatchedEnv(Protocol):
    """E copies of one multi-agent environment that step together.

    A copy has no state before its first `reset`. Nothing resets by itself: who steps a copy past
    its end gets what the simulator makes of it.
    """

    @property
    def spec(self) -> TeamSpec:
        """The team: names, sizes, bounds."""
        ...

    @property
    def copies(self) -> int:
        """E."""
        ...

    def reset(self, which: NDArray[np.int64], seeds: NDArray[np.int64]) -> None:
        """Start a new episode in the copies `which` (n,), each from its own seed (n,) >= 0.

        The initial state is a function of the seed alone, the same one as that of the task's
        reference implementation (`gymnasium.Env.reset(seed=seed)` for the robots).
        """
        ...

    def observe(self) -> tuple[Float32, ...]:
        """Observations of the current states, N x (E, observation_size).

        Freshly allocated at each call, so the caller may keep them. Agents that see the same
        thing are given the same array: do not write into it.
        """
        ...

    def step(self, actions: Sequence[Float32]) -> Outcome:
        """Advance all copies by one step; `actions` is N x (E, action_size).

        Actions are clipped to the agents' bounds first, and rewards are those of the clipped
        actions.

        Raises:
            ValueError: an array of the wrong shape, or an action that is not finite. No copy has
                moved then.
        """
        ...

    def state(self) -> Float64:
        """The simulator's full state, (E, state_size): what `set_state` needs to go on exactly."""
        ...

    def set_state(self, state: Float64) -> None:
        """Continue all copies from `state` (E, state_size), so that steps can be repeated."""
        ...

    def close(self) -> None:
        """Release the simulator."""
        ...


@runtime_checkable
class Contest(Protocol):
    """What a `BatchedEnv` has besides where episodes are won or lost."""

    @property
    def success(self) -> Bool:
        """In which copies the last step won the episode, (E,)."""
        ...


@runtime_checkable
class Versioned(Protocol):
    """What a `BatchedEnv` has besides where it is more than Python packages."""

    @property
    def versions(self) -> Mapping[str, str]:
        """Version of the simulator and of what drives it, for the log; after the first reset."""
        ...


def at_least_one(copies: int) -> int:
    """`copies`, E. Raises ValueError if it is less than one."""
    if copies < 1:
        raise ValueError(f"an environment needs at least one copy, not {copies}")
    return copies


class JointActions:
    """Checks the agents' actions, joins them to rows and clips them, in buffers used again."""

    def __init__(self, spec: TeamSpec, copies: int) -> None:
        self._names = spec.names
        self._low = np.array([x for agent in spec.agents for x in agent.action_low], np.float32)
        self._high = np.array([x for agent in spec.agents for x in agent.action_high], np.float32)
        self._rows = np.empty((copies, len(self._low)), np.float32)
        self._shapes = [(copies, agent.action_size) for agent in spec.agents]

    def clipped(self, actions: Sequence[Float32]) -> Float32:
        """The joint action (E, sum of action sizes); valid until the next call.

        Raises:
            ValueError: an array of the wrong shape, or an action that is not finite.
        """
        shapes = [action.shape for action in actions]
        if shapes != self._shapes:
            raise ValueError(
                f"the actions of {self._names} have shapes {shapes}, not {self._shapes}"
            )
        rows = np.concatenate(actions, axis=1, out=self._rows)
        if not all_finite(rows):
            raise ValueError("an action is not finite (NaN or infinity)")
        # Not np.clip: it takes longer than the two together.
        np.maximum(rows, self._low, out=rows)
        return np.minimum(rows, self._high, out=rows)
