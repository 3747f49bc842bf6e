"""Joint transitions: what makes and imports data sets hands to the store, which splits them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from otc_dist.transitions import Bool, Float32, Transitions


@dataclass(frozen=True)
class JointTransitions:
    """T transitions of a whole team. Tuples are indexed by agent, arrays by transition.

    The rows of one episode stand in the order of time; rows of several episodes may interleave.
    Agents that see the same thing may share one array: nobody writes into it.
    """

    observations: tuple[Float32, ...]  # N x (T, observation_size)
    actions: tuple[Float32, ...]  # N x (T, action_size)
    rewards: tuple[Float32, ...]  # N x (T,)
    next_observations: tuple[Float32, ...]  # N x (T, observation_size), the true successors s'
    terminated: Bool  # (T,)
    truncated: Bool  # (T,)
    episodes: NDArray[np.int64]  # (T,) which episode a row belongs to

    def __len__(self) -> int:
        return len(self.episodes)

    def of_agent(self, index: int) -> Transitions:
        """What agent `index` may see: its own transitions, and nothing of the others."""
        return Transitions(
            self.observations[index],
            self.actions[index],
            self.rewards[index],
            self.next_observations[index],
            self.terminated,
            self.truncated,
        )
