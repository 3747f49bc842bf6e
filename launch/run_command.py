"""`launch NAME`: from the command line to a run folder that is ready to be conducted."""

import argparse
import errno
from contextlib import ExitStack
from pathlib import Path

from otc_dist.description import Description
from otc_dist.errors import UserError
from otc_dist.run_folder import RunFolder

from . import descriptions, plan, run_record
from .conduct import conduct
from .parser import Parser
from .resolve import resolve


def main(argv: list[str]) -> int:
    """Run, resume, list or plan. Returns the exit status.

    Raises:
        UserError: anything the user can mend: one line, status 2.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    if arguments.list:
        shipped = descriptions.shipped()
        width = max(map(len, shipped))
        for name, path in shipped.items():
            print(f"{name:{width}} {Description.load(path).summary}")
        return 0
    try:
        if arguments.resume is not None:
            return _resume(arguments)
        if arguments.description is None:
            raise UserError("which description? --list shows those that come with the package")
        return _start(arguments)
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise UserError(
                f"no disk space left: {error.filename or 'in the run folder'}"
            ) from None
        raise


def _start(arguments: argparse.Namespace) -> int:
    quick: bool = arguments.quick
    chosen = descriptions.load(arguments.description, arguments.set, arguments.seed, quick)
    description = resolve(chosen)
    label = "-quick" if quick else ""
    out: Path = arguments.out or Path("runs") / f"{description.name}{label}-seed{description.seed}"
    if arguments.dry_run:
        planned = plan.make(description, RunFolder(out.resolve()), out.name)
        if quick:
            print(descriptions.QUICK_LABEL)
        print("\n".join(planned.lines()))
        return 0
    planned = plan.make(description, RunFolder(out.resolve()), out.name)
    folder = run_record.make_folder(out, planned.disk_bytes)
    with run_record.locked(folder):
        record = run_record.create(folder, description, quick)
        return conduct(plan.make(description, folder, record.run), record)


def _resume(arguments: argparse.Namespace) -> int:
    given = [
        flag
        for flag, value in (
            ("a description", arguments.description),
            ("--set", arguments.set),
            ("--seed", arguments.seed is not None),
            ("--out", arguments.out),
            ("--quick", arguments.quick),
            ("--dry-run", arguments.dry_run),
        )
        if value
    ]
    if given:
        raise UserError(f"--resume goes on with the run as it was begun: leave out {given[0]}")
    folder = RunFolder(arguments.resume.resolve())
    with ExitStack() as stack:
        run_record.RunRecord.read(folder)  # a folder without one is not a run's: no lock in it
        stack.enter_context(run_record.locked(folder))
        record, description = run_record.reopen(folder)
        return conduct(plan.make(description, folder, record.run), record)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m otc_dist.launch",
        description="Run a launch description: data, offline training, deployments, report.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "description", nargs="?", help="a shipped description's name, or a TOML file"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="section.key=value", help="change one value"
    )
    parser.add_argument("--seed", type=_seed, help="the run's seed")
    parser.add_argument("--out", type=Path, help="run folder (default: runs/NAME-seedSEED)")
    parser.add_argument("--resume", type=Path, metavar="RUN", help="go on with an unfinished run")
    parser.add_argument("--quick", action="store_true", help=descriptions.QUICK_LABEL)
    parser.add_argument("--dry-run", action="store_true", help="print what would run, and stop")
    parser.add_argument("--list", action="store_true", help="list the shipped descriptions")
    return parser


def _seed(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None
