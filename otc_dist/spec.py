"""What an environment's team looks like from outside: names, sizes and bounds."""

from dataclasses import dataclass


@dataclass(frozen=True)
class AgentSpec:
    """One agent's own interface: a float32 observation vector in, a bounded action vector out."""

    name: str
    observation_size: int
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]

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
