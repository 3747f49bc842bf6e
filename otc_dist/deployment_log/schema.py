"""What a record holds, for readers that do not know us."""

import json

from otc_dist.deployment_log.record import PER_AGENT, RecordLayout


def payload_schema(layout: RecordLayout) -> bytes:
    """The payload as a JSON schema. Arrays are msgpack `bin`: raw, C order, as in its dtype."""

    def binary(dtype: str, shape: tuple[int, ...], text: str) -> dict[str, object]:
        return {
            "type": "string",
            "contentMediaType": "application/octet-stream",
            "dtype": dtype,
            "shape": list(shape),
            "description": text,
        }

    copies = (layout.copies,)
    meaning = {
        "observations": "what the agent saw before the step",
        "actions": "as the agent sent them",
        "rewards": "of this step",
        "next_observations": "the true successors, also where the episode ended",
    }
    properties: dict[str, object] = {"step": {"type": "integer", "description": "from 0"}}
    for name in PER_AGENT:
        properties[name] = {
            "type": "array",
            "description": f"by agent: {meaning[name]}",
            "prefixItems": [
                binary("<f4", shape, agent.name)
                for agent, shape in zip(layout.team.agents, layout.shapes[name], strict=True)
            ],
        }
    properties |= {
        "terminated": binary("|b1", copies, "by copy: the task ended here"),
        "truncated": binary("|b1", copies, "by copy: the time limit ended the episode"),
        "exploring": {
            "type": "array",
            "description": "by agent: it explored",
            "items": {"type": "boolean"},
        },
        "episode_seeds": binary("<i8", copies, "by copy: seed of the step's episode"),
        "state": binary(
            "<f8", (layout.copies, layout.team.state_size), "simulator state before the step"
        ),
    }
    if layout.timed:
        properties |= {
            "held": {
                "type": "array",
                "description": "by agent: its answer was not there in time, and its action before"
                " was executed once more",
                "items": {"type": "boolean"},
            },
            "late": {"type": "boolean", "description": "the next observations came late"},
        }
    properties |= {
        "crc32": {
            "type": "integer",
            "description": "of the payload without its last 5 bytes, which are this field;"
            " computed on from the header's `binding` where it has one",
        },
    }
    return json.dumps(
        {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": "JointStep",
            "description": "One lock-step of all environment copies and agents, a msgpack map."
            " Strings with a dtype are msgpack bin: raw arrays in C order.",
            "type": "object",
            "properties": properties,
            "required": list(properties),
        }
    ).encode()
