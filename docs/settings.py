"""Writes docs/reference/settings.md from the models that check a description.

python docs/settings.py
"""

from pathlib import Path
from textwrap import fill
from typing import Any

from otc_dist import Description
from otc_dist.description.kinds import ALGORITHMS, STRATEGIES

PAGE = Path(__file__).parent / "reference" / "settings.md"
HEAD = """\
# Settings

<!-- Written by `python docs/settings.py`; tests/test_reference.py compares. -->

All that a run depends on, section by section. A description is a TOML file with these sections, and
`--set section.key=value` changes one value of it ([running](../running.md)); where one setting is
given twice, the last counts. Unknown keys, values out of range, and on the command line settings
that nothing obeys, like `sampling.alpha` where nothing is accepted by rank, are refused in one
line. The run's folder keeps the resolved description, in which every value stands. README says
[which settings to use](../../README.md#which-settings-to-use).
"""
COMPARED = {
    "minimum": "≥",
    "exclusiveMinimum": ">",
    "maximum": "≤",
    "exclusiveMaximum": "<",
}
KINDS = {"algorithm": ALGORITHMS, "sampling": STRATEGIES}  # one of several models, by a name in it
NAMES = {"integer": "integer", "number": "number", "string": "text", "boolean": "true or false"}
WIDTH = 100
LARGEST = 2**31  # a bound from here on is that of a type, not of what makes sense


def page() -> str:
    """The whole page, in Markdown."""
    schema = Description.model_json_schema()
    models, fields = schema["$defs"], schema["properties"]
    own = {name: field for name, field in fields.items() if not _models(field)}
    parts = [HEAD, "## Before all sections\n", _table(own, schema.get("required", ()))]
    for name, field in fields.items():
        chosen = [KINDS[name].section(one).model_json_schema() for one in KINDS.get(name, ())]
        for model in chosen or [models[found] for found in _models(field)]:
            named = f', `name = "{model["properties"]["name"]["const"]}"`' if chosen else ""
            parts += [
                f"## `[{name}]`{named}\n",
                fill(model.get("description", "").split("\n\nAttributes:")[0], WIDTH) + "\n",
                _table(model["properties"], model.get("required", ())),
            ]
    return "\n".join(parts)


def _models(field: dict[str, Any]) -> list[str]:
    """Names of the models that a section's field may be; none of a plain value."""
    found = [field, *field.get("allOf", ())]
    return [one["$ref"].rpartition("/")[2] for one in found if "$ref" in one]


def _table(fields: dict[str, Any], required: Any) -> str:
    lines = ["| setting | value | default | meaning |", "| --- | --- | --- | --- |"]
    shown = {
        name: field for name, field in fields.items() if "const" not in field
    }  # in the heading
    if not shown:
        return "It has no settings.\n"
    for name, field in shown.items():
        default = "required" if name in required else _shown(field.get("default"))
        meaning = " ".join(field.get("description", "").split()).replace("|", "\\|")
        lines.append(f"| `{name}` | {_kind(field)} | {default} | {meaning} |")
    return "\n".join(lines) + "\n"


def _kind(field: dict[str, Any]) -> str:
    """What a value may be, in words."""
    if choices := field.get("enum"):
        return ", ".join(f"`{choice}`" for choice in choices)
    if several := field.get("anyOf"):
        return " or ".join("unset" if one["type"] == "null" else _kind(one) for one in several)
    if field["type"] == "array":
        return f"list of {_kind(field['items'])}"
    bounds = [
        f"{sign} {field[key]:g}"
        for key, sign in COMPARED.items()
        if key in field and field[key] < LARGEST
    ]
    return " ".join([NAMES[field["type"]], ", ".join(bounds)]).strip()


def _shown(default: object) -> str:
    if default is None:
        return "unset"
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{default!r}`".replace("'", '"')


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
