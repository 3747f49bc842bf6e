"""`section.key=value` assignments, and one clear line for what is wrong with a description."""

import re
import tomllib
from collections.abc import Mapping
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from otc_dist.description.kinds import ALGORITHMS, STRATEGIES
from otc_dist.terminal.errors import UserError, unknown


def key_of(assignment: str) -> str:
    """Which value `section.key=value` changes."""
    return assignment.partition("=")[0].strip()


def assign(data: dict[str, object], assignment: str) -> None:
    """Write the value of `section.key=value` into nested dictionaries; UserError if it is none."""
    path, equals, text = assignment.partition("=")
    *sections, key = path.strip().split(".")
    if not equals or not key:
        raise UserError(f"--set {assignment!r}: write section.key=value, like sampling.share=0.2")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        value = text.strip()  # a bare word is a string
    target = data
    for section in sections:
        below = target.get(section, {})
        if not isinstance(below, dict):
            raise UserError(f"--set {assignment!r}: {section!r} is a value, not a section")
        target[section] = below = dict(below)
        target = below
    target[key] = value


def explain(
    root: type[BaseModel], problem: ErrorDetails, source: str, data: Mapping[str, object]
) -> UserError:
    """One line for a validation error of `root`, with the nearest known name if one is unknown.

    Args:
        data: what was validated.
    """
    *sections, key = [str(part) for part in problem["loc"]] or [""]
    where = ".".join([*sections, key])
    if problem["type"] == "extra_forbidden":
        known = _fields(root, sections, data)
        return UserError(
            f"{source}: {unknown('key', where, ['.'.join([*sections, k]) for k in known])}"
        )
    if problem["type"] == "literal_error":
        known = re.findall(r"'([^']*)'", problem.get("ctx", {}).get("expected", ""))
        return UserError(f"{source}: {unknown(where, str(problem['input']), known)}")
    if problem["type"] == "missing":
        return UserError(f"{source}: {where} is missing: it has no default")
    if problem["type"] in ("model_type", "model_attributes_type"):
        return UserError(f"{source}: {where} is a section: write {where}.KEY")
    if problem["type"] == "tuple_type":
        return UserError(f"{source}: {where} must be a list in brackets, not {problem['input']!r}")
    message = problem["msg"].removeprefix("Value error, ")
    given = f", not {problem['input']!r}" if key and problem["type"] != "value_error" else ""
    message = message[0].lower() + message[1:]
    return UserError(f"{source}: {where + ': ' if where else ''}{message}{given}")


def _fields(root: type[BaseModel], sections: list[str], data: Mapping[str, object]) -> list[str]:
    """Keys of the section that holds the unknown one."""
    if sections == ["algorithm"]:
        return ALGORITHMS.keys(data[sections[0]])
    if sections == ["sampling"]:
        return STRATEGIES.keys(data[sections[0]])
    model: Any = root
    for section in sections:
        if get_origin(model) is dict:  # sections by names of the user's
            model = get_args(model)[1]
        elif _is_section(model):
            model = model.model_fields[section].annotation
    return list(model.model_fields) if _is_section(model) else []


def _is_section(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
