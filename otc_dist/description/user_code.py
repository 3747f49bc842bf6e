"""Code of the user's own, named `module:function`, or `module:Class`: imported only where the user
allowed it by name.

A log, a data set or a run folder can name such code, and may come from somebody else. To read one
must never run what it names. So nothing is imported but what `allow` was given in this process:
by a description that is run, by a name on the command line, by `--allow module:function`, or by
`allow=` in Python.
"""

import argparse
import importlib
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from otc_dist.names import is_code
from otc_dist.terminal.errors import UserError

_OURS = __name__.partition(".")[0]
_INSTALLED = tuple({Path(path) for path in sysconfig.get_paths().values()})
_allowed: set[str] = set()
_brought: dict[str, frozenset[str]] = {}


def allow(*references: str) -> None:
    """Let this process import these; what has not the form `module:function` is ignored."""
    _allowed.update(filter(is_code, references))


def allow_all(references: str | Iterable[str]) -> None:
    """As `allow`, for one or several given by a caller in Python."""
    allow(*((references,) if isinstance(references, str) else references))


def allowed(reference: str) -> bool:
    """Whether this process may import that."""
    return reference in _allowed


def require(*references: str) -> None:
    """Raises UserError, which says how to allow it, if one of these is code and not allowed."""
    for reference in filter(is_code, references):
        if reference not in _allowed:
            raise UserError(
                f"{reference} is code, which reading a file does not run: if you know it and trust"
                f" it, add --allow {reference} (in Python: allow={reference!r})"
            )


def found(reference: str) -> Callable[..., object]:
    """The function, or the class, that `module:function` names.

    Raises:
        UserError: it is not allowed, and nothing was imported; or there is no such module.
        Exception: whatever the import raises.
    """
    require(reference)
    module, _, function = reference.partition(":")
    before = frozenset(sys.modules)
    try:
        named: Callable[..., object] = getattr(importlib.import_module(module), function)
    except ModuleNotFoundError as error:
        raise UserError(
            f"{reference}: there is no module {error.name}; start from the folder that holds it, or"
            " install it"
        ) from None
    _brought.setdefault(reference, frozenset(sys.modules) - before)
    return named


def named(reference: str, *, trusted: bool = False) -> Any:
    """What `module:Name` names; what it offers is a matter of who asks.

    Args:
        trusted: whether it is of this package, which needs to be allowed by nobody.

    Raises:
        UserError: it is not allowed, or cannot be loaded; one line.
    """
    if trusted:
        module, _, attribute = reference.partition(":")
        return getattr(importlib.import_module(module), attribute)
    try:
        return found(reference)
    except UserError:
        raise
    except (Exception, SystemExit) as error:  # whatever the user's code raises
        raise UserError(f"{reference} cannot be loaded: {described(error)}") from error


def brought(reference: str) -> frozenset[str]:
    """The modules that were loaded when it was first found in this process."""
    return _brought[reference]


def described(error: BaseException) -> str:
    """The exception's type and message, and the place in the user's code that raised it."""
    said = " ".join(str(error).split())
    text = f"{type(error).__name__}: {said}" if said else type(error).__name__
    # What is below the user's last line are packages that it called.
    places = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if not frame.f_code.co_filename.startswith("<") and not _is_ours(frame.f_globals)
    ]
    own = [
        (file, line)
        for file, line in places
        if not any(Path(file).is_relative_to(folder) for folder in _INSTALLED)
    ]
    place = (own or places)[-1:]
    return f"{text} ({place[0][0]}:{place[0][1]})" if place else text


def _is_ours(names: Mapping[str, Any]) -> bool:
    """Whether a module's names are those of one of this package, also of one that is run."""
    spec = names.get("__spec__")
    return spec is not None and spec.name.partition(".")[0] == _OURS


def check_offers(part: object, protocol: type, reference: str) -> None:
    """Raises UserError, before anything is trained, if a part lacks what is asked of its kind."""
    asked = (name for name in vars(protocol) if not name.startswith("_"))
    if lacking := [name for name in asked if not hasattr(part, name)]:
        raise UserError(
            f"{reference} has no {', '.join(lacking)}: {protocol.__module__}.{protocol.__name__}"
            " says what is asked of it"
        )


@contextmanager
def answers_for(*references: str, but: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Turn what is raised into a UserError that says where, if one of these is code: a mistake of
    the user's own then, and of ours if none is.

    Args:
        but: exceptions that mean something else.
    """
    named = " or ".join(filter(is_code, references))
    try:
        yield
    except Exception as error:  # whatever the user's code raises
        if not named or isinstance(error, (UserError, OSError, *but)):
            raise
        raise UserError(f"{named} failed: {described(error)}") from error


def add_flag(parser: argparse.ArgumentParser) -> None:
    """`--allow`, for a command that reads files which may name code."""
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        type=_reference,
        metavar="MODULE:FUNCTION",
        help="run this code if a file names it, as the environment it was played in or an algorithm"
        " of its own; may be given again",
    )


def _reference(text: str) -> str:
    if not is_code(text):
        raise argparse.ArgumentTypeError(f"{text!r} does not have the form module:function")
    return text
