"""TOML that a user wrote: what is wrong with it is one clear line."""

import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from otc_dist.description.assignments import explain
from otc_dist.terminal.errors import UserError

M = TypeVar("M", bound=BaseModel)


def parse(text: str, source: str) -> dict[str, Any]:
    """What TOML that `source` holds says. Raises UserError if it is none."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # of TOML, of a number, of too many brackets
        raise UserError(f"{source} is not valid TOML: {error}") from None


def read(path: Path, what: str = "") -> dict[str, Any]:
    """What a file says.

    Args:
        what: the kind of file, for the message.

    Raises:
        UserError: it cannot be read, or is no TOML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        name = f"{what} {path}" if what else path
        raise UserError(f"cannot read {name}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise UserError(f"{path} is not valid TOML: {error}") from None
    return parse(text, str(path))


def load(model: type[M], path: Path, what: str = "") -> M:
    """What a file says, as `model`.

    Raises:
        UserError: as `read`; or it has an unknown key or a bad value.
    """
    data = read(path, what)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise explain(model, error.errors()[0], str(path), data) from None
