"""`--on slurm`: the jobs of a comparison in a cluster's queue, in place of this machine's cores."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import aligned, say

from ..supervise import slurm
from ..supervise.jobs import Job
from ..supervise.processes import MISTAKE

_SOON = 3.0  # seconds


def add_flags(parser: Parser) -> None:
    """The flags of a command whose jobs can be queued."""
    group = parser.add_argument_group("on a cluster (see docs/comparison.md)")
    group.add_argument(
        "--on",
        choices=["slurm"],
        help="submit the jobs to a queue, and return; the same command later submits what was"
        " ended before its time, and shows what is complete",
    )
    group.add_argument(
        "--slurm",
        action="append",
        default=[],
        metavar="key=value",
        help="an option of sbatch for every job, like partition=cpu, time=4:00:00, mem=4G",
    )
    group.add_argument(
        "--status", action="store_true", help="with --on slurm: where the jobs stand; submit none"
    )


def options(arguments: argparse.Namespace) -> tuple[str, ...] | None:
    """sbatch's options; None: nothing is to be queued. UserError: they are wrong, or idle."""
    if arguments.on:
        return slurm.options(arguments.slurm)
    if arguments.slurm or arguments.status:
        raise UserError(f"{'--status' if arguments.status else '--slurm'} needs --on slurm")
    return None


def submit(jobs: Sequence[Job], wanted: Sequence[str]) -> int:
    """Submit what is to be submitted, and say how much that is. Returns the exit status.

    Raises:
        UserError: SLURM does not answer, or refuses the first of these jobs.
    """
    made = slurm.submit(jobs, wanted)
    for line in made.ended:
        say(f"{line}; submitted again")
    before = f"; {made.before} were in the queue before" if made.before else ""
    number = f"{made.new} job{'' if made.new == 1 else 's'}"
    print(f"{number} submitted{before}; --status shows them, the same command what is complete")
    if made.refused:
        say(f"error: {made.refused}; the same command submits the rest", file=sys.stderr)
    return MISTAKE if made.refused else 0


def keep_out(jobs: Sequence[Job], folders: Sequence[Path]) -> None:
    """See that no job that is to be done here is in the queue. Raises UserError if one is.

    Where no SLURM answers soon there is nothing to see; two that make the same waste time only.
    """
    left = [
        job.product
        for job in jobs
        if not job.done and any(map(job.product.is_relative_to, folders))
    ]
    if not left:
        return
    try:
        queued = slurm.queue(_SOON)
    except UserError:
        return
    if ids := [queued[product].id for product in left if product in queued]:
        raise UserError(
            f"SLURM's queue has {len(ids)} of these jobs: add --on slurm, or take them out of it"
            f" first: scancel {' '.join(ids)}"
        )


def show(jobs: Sequence[Job]) -> None:
    """Print where the jobs stand. UserError: SLURM does not answer."""
    rows = list(slurm.status(jobs))
    say(f"{len(jobs) - len(rows)} of {len(jobs)} jobs are done", *(aligned(rows) if rows else ()))
