"""Joint transitions: what makes and imports data sets hands to the store, which splits them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.transitions import Joint, JointStep


@dataclass(frozen=True)
class JointTransitions(Joint):
    """T transitions of a whole team, of several episodes.

    The rows of one episode stand in the order of time; rows of several episodes may interleave.
    Agents that see the same thing may share one array: nobody writes into it.
    """

    episodes: NDArray[np.int64]  # (T,) which episode a row belongs to

    def __len__(self) -> int:
        return len(self.episodes)

    def __getitem__(self, rows: NDArray[np.int64]) -> "JointTransitions":
        """The transitions of these numbers."""
        return JointTransitions._of([self], lambda parts: parts[0][rows])

    @classmethod
    def concatenate(cls, parts: Sequence["JointTransitions"]) -> "JointTransitions":
        """Join at least one part, in order."""
        return cls._of(parts, np.concatenate)

    @classmethod
    def of_steps(cls, steps: Sequence[JointStep]) -> "JointTransitions":
        """All of a deployment's, in the order of (step, copy)."""
        return cls.concatenate(
            [
                cls(
                    step.observations,
                    step.actions,
                    step.rewards,
                    step.next_observations,
                    step.terminated,
                    step.truncated,
                    step.episode_seeds,
                )
                for step in steps
            ]
        )

    @classmethod
    def _of(
        cls, parts: Sequence["JointTransitions"], join: Callable[[list[Any]], Any]
    ) -> "JointTransitions":
        """What `join` makes of the parts' arrays; one that agents share is made once."""
        made: dict[tuple[int, ...], Any] = {}

        def joined(arrays: list[Any]) -> Any:
            key = tuple(map(id, arrays))
            if key not in made:
                made[key] = join(arrays)
            return made[key]

        def of_agents(name: str) -> Any:
            agents = range(len(parts[0].rewards))
            return tuple(joined([getattr(part, name)[i] for part in parts]) for i in agents)

        return cls(
            *map(of_agents, ("observations", "actions", "rewards", "next_observations")),
            *(
                joined([getattr(part, name) for part in parts])
                for name in ("terminated", "truncated", "episodes")
            ),
        )
