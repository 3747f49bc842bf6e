"""Writing what was asked for: it is there whole, under its name, or nothing is.

What is made of a part of a deployment is not taken for the whole: that is said besides.
"""

import os
import shutil
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from otc_dist.deployment_log.format import existing
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
def claimed(
    out: Path, *, force: bool, reads: Iterable[Path], marker: str | None = None
) -> Iterator[Path]:
    """A path to write a file or a folder to; it becomes `out` when the block ends well.

    Otherwise whatever was written is removed, and what was at `out` before is still there.

    Args:
        reads: what it is made of, which `out` never replaces, by whatever name it goes.
        marker: the file by which a folder shows that it was made by the same command, so that
            another may replace it; None: a file is written, which replaces no folder.

    Raises:
        UserError: `out` is one of `reads`, or a folder of something else; it exists and `force` is
            not set; the disk is full, ...
    """
    _check_replaceable(out, reads, marker)
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


def _check_replaceable(out: Path, reads: Iterable[Path], marker: str | None) -> None:
    """Raises UserError: something would be lost that no flag may take away."""
    if not out.exists():
        return
    for path in filter(Path.exists, map(existing, reads)):
        if out.samefile(path) or path.resolve().is_relative_to(out.resolve()):
            raise UserError(f"{out} is what is read, or holds it: write to another place")
    if not out.is_dir():
        return
    if marker is None:
        raise UserError(f"{out} is a folder: name a file")
    if any(out.iterdir()) and not (out / marker).exists():
        raise UserError(f"{out} is a folder with something else in it: choose another --out")
