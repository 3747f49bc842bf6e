"""Writing what was asked for: it is there whole, under its name, or nothing is.

What is made of a part of a deployment is not taken for the whole: that is said besides.
"""

import os
import shutil
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from otc_dist.deployment_log.reader import LogSummary
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say


def note_shortfall(summary: LogSummary) -> None:
    """Say so, beside the result, where a log does not hold its whole deployment."""
    if summary.extent.shortfall is not None:
        say(f"note: {summary.path} is {summary.extent.shortfall}", file=sys.stderr)


@contextmanager
def ended_in_order() -> Iterator[None]:
    """On SIGTERM, a command ends as on Ctrl-C: nothing half-written is left."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def claimed(out: Path, *, force: bool) -> Iterator[Path]:
    """A path to write a file or a folder to; it becomes `out` when the block ends well.

    Otherwise whatever was written is removed, and what was at `out` before is still there.

    Raises:
        UserError: `out` exists and `force` is not set; the disk is full, ...
    """
    if out.exists() and not force:
        raise UserError(f"{out} exists; --force replaces it")
    temporary = out.with_name(f".{out.name}.{os.getpid()}.new")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        if out.is_dir() and not out.is_symlink():
            shutil.rmtree(out)
        temporary.replace(out)
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise UserError(f"cannot write {out}: {reason}") from None
    finally:
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            temporary.unlink(missing_ok=True)
