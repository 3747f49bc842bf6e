"""`--on slurm`: the jobs of a comparison in a cluster's queue, in place of this machine's cores."""

import argparse
import sys
from collections.abc import Sequence

from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import aligned, say

from ..supervise import slurm
from ..supervise.jobs import Job
from ..supervise.processes import MISTAKE


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
    count, refused = slurm.submit(jobs, wanted)
    waiting = sum(not job.done for job in jobs) - count - bool(refused)
    before = "" if refused or not waiting else f"; {waiting} were in the queue before"
    print(f"{count} jobs submitted{before}; --status shows them, the same command what is complete")
    if refused:
        say(f"error: {refused}; the same command submits the rest", file=sys.stderr)
    return MISTAKE if refused else 0


def show(jobs: Sequence[Job]) -> None:
    """Print where the jobs stand. UserError: SLURM does not answer."""
    rows = list(slurm.status(jobs))
    say(f"{len(jobs) - len(rows)} of {len(jobs)} jobs are done", *(aligned(rows) if rows else ()))
