"""The JSON schemas of the channels with scalars that viewers plot."""

import json
from collections.abc import Mapping

from otc_dist.spec import TeamSpec

Json = dict[str, object]

STEP = "otc_dist.StepScalars"
TUNING = "otc_dist.Tuning"

_NUMBER: Json = {"type": "number"}
_INTEGER: Json = {"type": "integer"}
_FLAG: Json = {"type": "boolean"}


def _object(**properties: Json) -> Json:
    return _record(properties, tuple(properties))


def _record(properties: Mapping[str, Json], required: tuple[str, ...]) -> Json:
    return {"type": "object", "properties": dict(properties), "required": list(required)}


def _encoded(title: str, description: str, schema: Json) -> bytes:
    return json.dumps({"title": title, "description": description, **schema}).encode()


def step_schema(team: TeamSpec) -> bytes:
    """Scalars by name, of the team and of each agent; one that is not finite is left out."""
    sums = {"reward": _NUMBER, "episode_return": _NUMBER}
    agents = {
        agent.name: _record(
            {
                "exploring": _FLAG,
                **sums,
                **{f"action_{i}": _NUMBER for i in range(agent.action_size)},
            },
            required=("exploring",),
        )
        for agent in team.agents
    }
    certain: dict[str, Json] = {
        "step": _INTEGER,
        "episode": _INTEGER,
        "episode_step": _INTEGER,
        "terminated": _FLAG,
        "truncated": _FLAG,
        "agents": _record(agents, tuple(agents)),
    }
    schema = _record({**certain, **sums}, tuple(certain))
    return _encoded(STEP, "Of one copy; rewards and returns are means over the agents", schema)


def tuning_schema() -> bytes:
    """What Eq. 4 came to for one agent."""
    schema = _object(deployment=_INTEGER, alpha=_NUMBER, similarity=_NUMBER)
    text = "Eq. 4 at one deployment: alpha, and the expected similarity 𝔻"
    return _encoded(TUNING, text, schema)
