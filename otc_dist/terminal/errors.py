"""The one exception whose message is meant for the user, not for a developer."""

import contextlib
import difflib
import errno
import gc
import os
import sys
import threading
from collections.abc import Callable, Iterable
from typing import NoReturn

from otc_dist.terminal import output
from otc_dist.terminal.printable import printable, say

_NEAR = 0.65  # of 1, by difflib: a letter or two are wrong; below, it is another word
_PART = 4  # letters of which a part of a name has at least


class UserError(Exception):
    """Something the user can fix. The message is one line: what was wrong, and what to do."""


def unknown(kind: str, name: str, known: Iterable[str]) -> UserError:
    """Error for an unknown `name` of some `kind`; what is near among the known is suggested."""
    names = sorted(known)
    bare = {one.lstrip("-"): one for one in names}  # that both are flags makes nothing near
    part = name.lstrip("-")
    near = difflib.get_close_matches(part, bare, n=1, cutoff=_NEAR) or [
        one for one in bare if len(part) >= _PART and part in one
    ]
    meant = " or ".join(repr(bare[one]) for one in near)
    hint = f"did you mean {meant}?" if near else f"known: {', '.join(names)}"
    return UserError(f"unknown {kind} {name!r}; {hint}")


def os_error_line(error: OSError) -> str:
    """What the system refused, in a line: the file and why."""
    reason = os.strerror(error.errno) if error.errno else str(error) or type(error).__name__
    if error.errno == errno.ENOSPC:
        reason = "no disk space left"
    return f"{error.filename}: {reason}" if error.filename else reason


def run_main(main: Callable[[list[str]], int]) -> None:
    """Run a command's `main(argv)` and exit: one clear line and status 2 for a UserError."""
    output.steady()
    try:
        status = main(sys.argv[1:])
    except UserError as error:
        say(printable(f"error: {error}"), file=sys.stderr)
        status = 2
    except KeyboardInterrupt:
        status = 130
    except OSError as error:  # a folder that cannot be read or written, a full disk
        say(printable(f"error: {os_error_line(error)}"), file=sys.stderr)
        status = 2
    leave(status)


def leave(status: int) -> NoReturn:
    """Exit; at once where a session is still closing on a thread of its own.

    A daemon thread that comes back from compiled code would abort the interpreter's own clean-up.
    """
    if any(thread.daemon for thread in threading.enumerate()):
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(status)
    gc.freeze()  # else every object of torch is looked at once more, for most of a second
    sys.exit(status)
