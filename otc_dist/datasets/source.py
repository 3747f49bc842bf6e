"""What a family of tasks offers as offline data: its levels, and who plays which rows of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from otc_dist.spec import TeamSpec
from otc_dist.transitions import Float32


class Behaviour(Protocol):
    """A team's play as a function of what it sees and of noise that is drawn beforehand."""

    def noise(self, random: np.random.Generator, steps: int) -> Float32:
        """All noise of one episode of at most `steps` steps: (steps, any size)."""
        ...

    def act(self, observations: Sequence[Float32], noise: Float32) -> Sequence[Float32]:
        """Actions N x (E, action_size) for observations N x (E, O) and one step's noise (E, size).

        A copy's actions are a function of its own rows alone, to the bit.
        """
        ...


class Source(Protocol):
    """The offline data of one family of tasks. The answers are functions of the arguments."""

    def offers(self, env_id: str) -> bool:
        """Whether this is the source of that environment's data."""
        ...

    def levels(self, env_id: str) -> tuple[str, ...]:
        """The levels that can be made."""
        ...

    def usual_size(self, env_id: str, level: str) -> int:
        """Transitions if nobody asks for another number."""
        ...

    def policies(self, env_id: str, level: str) -> tuple[str, ...]:
        """Names of the behaviours that make a level, in the order of its rows, in equal shares."""
        ...

    def behaviour(self, env_id: str, policy: str) -> Behaviour:
        """The behaviour of that name."""
        ...

    def seed_name(self, env_id: str) -> str:
        """What stands for the environment in the episodes' seeds."""
        ...

    def recipe(self, env_id: str, level: str) -> dict[str, str]:
        """What determines the rows besides level, seed and our own version."""
        ...

    @property
    def packages(self) -> tuple[str, ...]:
        """Packages whose versions the card records, besides NumPy and our own."""
        ...


@dataclass(frozen=True)
class Part:
    """Consecutive rows of a data set that one behaviour made."""

    policy: str
    start: int  # first row
    stop: int  # after the last row


class ActionSlices:
    """Where each agent's entries lie in the joint action."""

    def __init__(self, team: TeamSpec) -> None:
        sizes = [agent.action_size for agent in team.agents]
        stops = np.cumsum(sizes).tolist()
        self.total = sum(sizes)
        self._slices = [slice(stop - size, stop) for size, stop in zip(sizes, stops, strict=True)]

    def split(self, joint: Float32) -> tuple[Float32, ...]:
        """N views of a joint action (..., A)."""
        return tuple(joint[..., part] for part in self._slices)


class Uniform:
    """Uniformly random actions, within the agents' bounds or of those available: a `Behaviour`."""

    def __init__(self, team: TeamSpec) -> None:
        low = np.array([x for agent in team.agents for x in agent.action_low], np.float32)
        high = np.array([x for agent in team.agents for x in agent.action_high], np.float32)
        self._low, self._range = low, high - low
        self._slices = ActionSlices(team)
        self._choices = [agent.choices for agent in team.agents]

    def noise(self, random: np.random.Generator, steps: int) -> Float32:
        return random.random((steps, len(self._low)), np.float32)

    def act(self, observations: Sequence[Float32], noise: Float32) -> Sequence[Float32]:
        drawn = self._slices.split(self._range * noise + self._low)
        return [
            _available(noise_of, seen[:, -choices:]) if choices else action
            for choices, action, noise_of, seen in zip(
                self._choices, drawn, self._slices.split(noise), observations, strict=True
            )
        ]


def _available(noise: Float32, mask: Float32) -> Float32:
    """The floor(n u)-th of n available actions, (E, 1), for u (E, 1) and masks (E, choices)."""
    order = np.cumsum(mask > 0, axis=1)
    count = order[:, -1:]
    number = np.minimum((count * noise).astype(np.int64), count - 1)
    action: Float32 = (order > number).argmax(axis=1).astype(np.float32)
    return action[:, None]
