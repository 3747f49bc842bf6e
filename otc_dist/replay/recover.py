"""`--recover`: a log anew, from every step of a damaged or unfinished one that is whole."""

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from otc_dist.deployment_log.finishing import write_finished
from otc_dist.deployment_log.format import PARTIAL_SUFFIX
from otc_dist.deployment_log.open_log import OpenLog
from otc_dist.deployment_log.record import Rows
from otc_dist.deployment_log.salvage import Salvage
from otc_dist.deployment_log.seeds import OwnSteps
from otc_dist.replay.output import claimed
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import say
from otc_dist.terminal.progress import Report, shown


def run(arguments: argparse.Namespace) -> int:
    """Write each file's whole steps to another log; 1 unless they are just its deployment's.

    Raises:
        UserError: two files and one output, an output that exists or is read, no whole step, a
            full disk.
    """
    files: list[Path] = arguments.files
    if arguments.out is not None and len(files) > 1:
        raise UserError("--out names one file, but there are several to recover; leave it out")
    outs = [arguments.out or recovered_path(path) for path in files]
    if len(set(outs)) < len(outs):
        twice = next(out for out in outs if outs.count(out) > 1)
        raise UserError(f"{twice} would be written twice: recover one file at a time, with --out")
    complete = True  # of all
    for path, out in zip(files, outs, strict=True):
        left_out = recover(path, out, beside=files, force=arguments.force)
        with OpenLog(out) as log:
            extent = log.extent
        line = f"{out}: {extent.shortfall or f'all of {extent.count}'}; missing: {extent.missing}"
        say(f"{line}; {left_out}" if left_out else line)
        complete = complete and extent.complete
    return 0 if complete else 1


def recovered_path(path: Path) -> Path:
    """Where the whole steps of `path` go: a.mcap and a.mcap.partial give a.recovered.mcap."""
    name = path.name.removesuffix(PARTIAL_SUFFIX).removesuffix(".mcap")
    return path.with_name(f"{name}.recovered.mcap")


def recover(path: Path, out: Path, *, force: bool, beside: Sequence[Path] = ()) -> str | None:
    """Write all whole steps of a log to a finished one, `out`; what was left out, in words.

    Args:
        beside: other logs that `out` does not replace.

    Raises:
        UserError: there is none, no header is whole, `out` exists, the disk is full, ...
    """
    with (
        Salvage(path) as found,
        claimed(out, force=force, reads=(path, *beside)) as unfinished,
        shown(f"searching {path.name}", "bytes") as report,
    ):
        own = OwnSteps(found.header)
        steps = partial(_reported, found, own, report)
        write_finished(
            unfinished, found.header, steps, found.policies(), recovered_from=found.source
        )
    return own.in_words


def _reported(found: Salvage, own: OwnSteps, report: Report) -> Iterator[Rows]:
    """All whole steps. Raises UserError if there is none."""
    some = False
    for rows in own.of(found.blocks()):
        some = True
        report(found.searched, found.size)
        yield rows
    if not some:
        line = f"; {own.in_words}" if own.in_words else ""
        raise UserError(f"{found.path} holds no whole step{line}")
    report(found.size, found.size)
