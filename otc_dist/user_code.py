"""Code of the user's own, named `module:function`: imported only where the user allowed it by name.

A log, a data set or a run folder can name such code, and may come from somebody else. To read one
must never run what it names. So nothing is imported but what `allow` was told of in this process:
by a description that is run, by a name on the command line, by `--allow module:function`, or by
`allow=` in Python.
"""

import argparse
import importlib
from collections.abc import Callable, Iterable

from otc_dist.errors import UserError
from otc_dist.names import is_code

_allowed: set[str] = set()


def allow(*references: str) -> None:
    """Let this process import these; what has not the form `module:function` is ignored."""
    _allowed.update(filter(is_code, references))


def allow_all(references: str | Iterable[str]) -> None:
    """As `allow`, for one or several given by a caller in Python."""
    allow(*((references,) if isinstance(references, str) else references))


def require(*references: str) -> None:
    """Raises UserError, which says how to allow it, if one of these is code and not allowed."""
    for reference in filter(is_code, references):
        if reference not in _allowed:
            raise UserError(
                f"{reference} is code, which reading a file does not run: if you know it and trust"
                f" it, add --allow {reference} (in Python: allow={reference!r})"
            )


def found(reference: str) -> Callable[[], object]:
    """The function that `module:function` names.

    Raises:
        UserError: it is not allowed; nothing was imported.
        Exception: whatever the import raises.
    """
    require(reference)
    module, _, function = reference.partition(":")
    named: Callable[[], object] = getattr(importlib.import_module(module), function)
    return named


def add_flag(parser: argparse.ArgumentParser) -> None:
    """`--allow`, for a command that reads files which may name code."""
    parser.add_argument(
        "--allow",
        action="append",
        default=[],
        type=_reference,
        metavar="MODULE:FUNCTION",
        help="run this code if a file names it, as the environment it was played in; may be given"
        " again",
    )


def _reference(text: str) -> str:
    if not is_code(text):
        raise argparse.ArgumentTypeError(f"{text!r} does not have the form module:function")
    return text
