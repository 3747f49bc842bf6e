"""The mapping file: which field of which ROS 2 topic is whose observation, action or reward.

    clock = "/joint_states"                    # each of its messages begins a step
    terminated = {topic = "/fell", field = "data"}       # and truncated, where there are such
    reward = {topic = "/reward", field = "data"}         # the team's; or one in each agent's table

    [agents.agent_0]
    observation = [{topic = "/joint_states", field = "position"}, {topic = "/imu", field = "..."}]
    action = [{topic = "/knee/command", field = "data"}]
    legals = [...]                             # the mask of discrete actions, if there is one

A field is a path, as `pose.position.x`, or `points[0].effort`; what is an array counts as its
numbers, and several fields stand one behind the other.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from otc_dist.names import AgentName
from otc_dist.spec import TeamSpec
from otc_dist.system.records import why
from otc_dist.terminal.errors import UserError

_LARGEST = 2**20  # bytes of a mapping file
_STEP = r"[A-Za-z][A-Za-z0-9_]*(\[[0-9]{1,6}\])?"  # ROS's field names; nothing of Python's own


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Numbers(_Table):
    """Numbers of one topic's messages."""

    topic: Annotated[str, Field(min_length=1, max_length=256)]
    field: Annotated[str, Field(pattern=rf"^{_STEP}(\.{_STEP})*$", max_length=256)]

    def __str__(self) -> str:
        return f"{self.field} of {self.topic}"


Several = Annotated[list[Numbers], Field(min_length=1)]


class AgentMapping(_Table):
    """One agent's part of the mapping."""

    observation: Several
    action: Several
    legals: list[Numbers] = []
    reward: Numbers | None = None  # None: the team's


class Mapping(_Table):
    """A mapping file."""

    clock: Annotated[str, Field(min_length=1)]
    agents: dict[AgentName, AgentMapping]
    reward: Numbers | None = None
    terminated: Numbers | None = None
    truncated: Numbers | None = None

    @classmethod
    def read(cls, path: Path, team: TeamSpec) -> Self:
        """The mapping in a file.

        Raises:
            UserError: it cannot be read, is no mapping, or is of another team.
        """
        try:
            if path.stat().st_size > _LARGEST:
                raise UserError(f"{path} is too large for a mapping file")
            made = cls.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
        except OSError as error:
            raise UserError(f"cannot read {path}: {error.strerror}") from None
        except ValidationError as error:
            raise UserError(f"{path} is no mapping: {why(error)}") from None
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path} is no TOML: {str(error).splitlines()[0]}") from None
        if set(made.agents) != set(team.names):
            raise UserError(
                f"{path} maps {', '.join(made.agents)}, but the agents of {team.env_id} are"
                f" {', '.join(team.names)}"
            )
        for agent in team.agents:
            mapped = made.agents[agent.name]
            if not (mapped.reward or made.reward):
                raise UserError(f"{path}: {agent.name} has no reward, and the team has none")
            if bool(mapped.legals) != bool(agent.choices):
                kind = "discrete: map their legals" if agent.choices else "continuous: no legals"
                raise UserError(f"{path}: the actions of {agent.name} are {kind}")
        return made

    @property
    def numbers(self) -> set[Numbers]:
        """All that is to be read."""
        found = {self.reward, self.terminated, self.truncated}
        for agent in self.agents.values():
            found |= {*agent.observation, *agent.action, *agent.legals, agent.reward}
        return {each for each in found if each is not None}
