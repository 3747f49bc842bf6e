"""What an environment's team looks like from outside: names, sizes, bounds, and what it is for."""

from dataclasses import dataclass
from typing import Annotated, Protocol, TypeVar

from pydantic import Field, FiniteFloat

from otc_dist.names import AgentName, EnvironmentId, check_agents

Array = TypeVar("Array")  # NumPy arrays and torch tensors alike

# Numbers in a vector, choices, steps: more is no environment, but a mistake or worse.
Size = Annotated[int, Field(strict=True, ge=1, le=2**24)]
SizeOrNone = Annotated[int, Field(strict=True, ge=0, le=2**24)]


@dataclass(frozen=True)
class AgentSpec:
    """One agent's own interface: a float32 observation vector in, a bounded action vector out.

    Attributes:
        choices: number of discrete actions, or 0 for continuous ones. A discrete action is the
            vector of one entry that holds its index. The last `choices` entries of the
            observation then say which actions are available (1) and which are not (0).
    """

    name: AgentName
    observation_size: Size
    action_low: tuple[FiniteFloat, ...]
    action_high: tuple[FiniteFloat, ...]
    choices: SizeOrNone = 0

    @property
    def action_size(self) -> int:
        return len(self.action_low)


@dataclass(frozen=True)
class TeamSpec:
    """All agents of one environment, in the order that every array and message follows.

    `state_size` is the length of the simulator's state (float64) that the deployment log keeps
    for verification; agents never receive it.
    """

    env_id: EnvironmentId
    agents: tuple[AgentSpec, ...]
    state_size: SizeOrNone
    max_episode_steps: Size

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(agent.name for agent in self.agents)

    def index(self, name: str) -> int:
        """Position of agent `name`; raises ValueError if there is none."""
        return self.names.index(name)


def check_team(team: TeamSpec) -> TeamSpec:
    """`team`, if its parts fit each other. Each part's own type is in the fields above.

    Raises:
        ValueError: no agents, names that will not do, or bounds that are none.
    """
    if not team.agents:
        raise ValueError(f"{team.env_id} has no agents")
    check_agents(team.names)
    for agent in team.agents:
        bounds = list(zip(agent.action_low, agent.action_high, strict=False))
        uneven = len(agent.action_low) != len(agent.action_high)
        if uneven or not bounds or any(low > high for low, high in bounds):
            raise ValueError(f"the bounds of the actions of {agent.name} do not fit each other")
        if agent.choices and (
            bounds != [(0.0, agent.choices - 1.0)] or agent.observation_size < agent.choices
        ):
            raise ValueError(f"the {agent.choices} choices of {agent.name} do not fit its sizes")
    return team


class Task(Protocol):
    """What a task asks for, as far as one agent can compute it; for algorithms with a model.

    Works on NumPy arrays and on torch tensors of any leading shape. Actions are the agent's own,
    scaled to [-1, 1].
    """

    def reward(self, observation: Array, action: Array, next_observation: Array) -> Array:
        """r (...) of <s (..., s), a_i (..., a), s' (..., s)>."""
        ...

    def terminated(self, next_observation: Array) -> Array:
        """Whether the task ends in s' (..., s), bool (...)."""
        ...
