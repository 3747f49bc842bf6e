"""What an environment's team looks like from outside: names, sizes, bounds, and what it is for."""

from dataclasses import dataclass
from typing import Protocol, TypeVar

Array = TypeVar("Array")  # NumPy arrays and torch tensors alike


@dataclass(frozen=True)
class AgentSpec:
    """One agent's own interface: a float32 observation vector in, a bounded action vector out.

    Attributes:
        choices: number of discrete actions, or 0 for continuous ones. A discrete action is the
            vector of one entry that holds its index. The last `choices` entries of the
            observation then tell which actions are available (1) and which are not (0).
    """

    name: str
    observation_size: int
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    choices: int = 0

    @property
    def action_size(self) -> int:
        return len(self.action_low)


@dataclass(frozen=True)
class TeamSpec:
    """All agents of one environment, in the order that every array and message follows.

    `state_size` is the length of the simulator's state (float64) that the deployment log keeps
    for verification; agents never receive it.
    """

    env_id: str
    agents: tuple[AgentSpec, ...]
    state_size: int
    max_episode_steps: int

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(agent.name for agent in self.agents)

    def index(self, name: str) -> int:
        """Position of agent `name`; raises ValueError if there is none."""
        return self.names.index(name)


class Task(Protocol):
    """What a task asks for, as far as one agent can tell: for algorithms that plan in a model.

    Works on NumPy arrays and on torch tensors of any leading shape. Actions are the agent's own,
    scaled to [-1, 1].
    """

    def reward(self, observation: Array, action: Array, next_observation: Array) -> Array:
        """r (...) of <s (..., s), a_i (..., a), s' (..., s)>."""
        ...

    def terminated(self, next_observation: Array) -> Array:
        """Whether the task ends in s' (..., s), bool (...)."""
        ...
