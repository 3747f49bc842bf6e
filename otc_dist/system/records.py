"""What is read back from a file is validated against its type; what is wrong is one line.

Files may come from somebody else, or from another version. A type is a pydantic model, a dataclass
or anything else that pydantic takes.
"""

from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError

from otc_dist.terminal.errors import UserError

T = TypeVar("T")
_LONGEST_VALUE = 60  # characters of a wrong value that are shown


def from_json(kind: type[T], content: str | bytes, source: str | Path) -> T:
    """JSON as a `kind`. Types are strict: "1" is no number.

    Raises:
        UserError: it is no JSON, a field is missing or of another type; `source` is named.
    """
    try:
        return cast(T, _adapter(cast(Any, kind)).validate_json(content, strict=True))
    except ValidationError as error:
        raise UserError(f"{source} is damaged: {why(error)}") from None


def read_json(kind: type[T], path: Path) -> T:
    """A JSON file as a `kind`, as `from_json`.

    Raises:
        FileNotFoundError: there is none.
        UserError: it cannot be read, or is wrong.
    """
    try:
        content = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(path) from None
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror}") from None
    return from_json(kind, content, path)


def why(error: ValidationError) -> str:
    """The first thing that is wrong, in a few words: where, what, and what stands there."""
    problem = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in problem["loc"])
    message = problem["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    if problem["type"] not in ("value_error", "missing", "json_invalid"):
        value = repr(problem["input"])
        shown = value if len(value) <= _LONGEST_VALUE else f"{value[:_LONGEST_VALUE]}..."
        message = f"{message}, not {shown}"
    return f"{where}: {message}" if where else message


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
