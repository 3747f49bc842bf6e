"""The JSON schemas of the channels that Foxglove shows.

Those of `foxglove.SceneUpdate` and `foxglove.FrameTransforms` have the fields that Foxglove
publishes (https://docs.foxglove.dev/docs/sdk/schemas) as far as we fill them: lists that stay
empty here are said to be empty. A reader goes by the schema's name.
"""

import json
from collections.abc import Mapping

from otc_dist.spec import TeamSpec

Json = dict[str, object]

SCENE = "foxglove.SceneUpdate"
TRANSFORMS = "foxglove.FrameTransforms"
STEP = "otc_dist.StepScalars"
TUNING = "otc_dist.Tuning"

_NUMBER: Json = {"type": "number"}
_INTEGER: Json = {"type": "integer"}
_TEXT: Json = {"type": "string"}
_FLAG: Json = {"type": "boolean"}


def _object(**properties: Json) -> Json:
    return _record(properties, tuple(properties))


def _record(properties: Mapping[str, Json], required: tuple[str, ...]) -> Json:
    return {"type": "object", "properties": dict(properties), "required": list(required)}


def _list(items: Json) -> Json:
    return {"type": "array", "items": items}


# The reader of these schemas wants an object's properties named, be there none.
_NONE: Json = {"type": "array", "items": {"type": "object", "properties": {}}, "maxItems": 0}

_TIME = _object(sec=_INTEGER, nsec=_INTEGER)
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COLOUR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_POSE = _object(position=_VECTOR, orientation=_QUATERNION)
_LINE_TYPE: Json = {
    "oneOf": [
        {"title": "LINE_STRIP", "const": 0},
        {"title": "LINE_LOOP", "const": 1},
        {"title": "LINE_LIST", "const": 2},
    ]
}
_ENTITY = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_FLAG,
    metadata=_NONE,
    arrows=_NONE,
    cubes=_NONE,
    spheres=_list(_object(pose=_POSE, size=_VECTOR, color=_COLOUR)),
    cylinders=_list(
        _object(pose=_POSE, size=_VECTOR, bottom_scale=_NUMBER, top_scale=_NUMBER, color=_COLOUR)
    ),
    lines=_list(
        _object(
            type=_LINE_TYPE,
            pose=_POSE,
            thickness=_NUMBER,
            scale_invariant=_FLAG,
            points=_list(_VECTOR),
            color=_COLOUR,
            colors=_NONE,
            indices=_NONE,
        )
    ),
    triangles=_NONE,
    texts=_NONE,
    models=_NONE,
)
_TRANSFORM = _object(
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)


def _encoded(title: str, description: str, schema: Json) -> bytes:
    return json.dumps({"title": title, "description": description, **schema}).encode()


def scene_schema() -> bytes:
    """What stands where: bodies as shapes fixed to frames."""
    text = "The bodies, each fixed to a frame, and what stands still"
    return _encoded(SCENE, text, _object(deletions=_NONE, entities=_list(_ENTITY)))


def transforms_schema() -> bytes:
    """Where the frames are."""
    text = "Where the bodies' frames are before the step"
    return _encoded(TRANSFORMS, text, _object(transforms=_list(_TRANSFORM)))


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
