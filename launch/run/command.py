"""`launch NAME`: from the command line to a run folder that is ready to run."""

import argparse
import sys
from contextlib import ExitStack
from pathlib import Path

from otc_dist.bus.keys import HOST
from otc_dist.comparison import arms, meanings
from otc_dist.description import Description, user_code
from otc_dist.description.assignments import key_of
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.commands import OF_LAUNCH, lines
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import say

from ..plan import descriptions, idle, new_folder, plan, preflight, run_record
from ..plan.beside import Beside
from ..plan.placement import Placement
from . import elsewhere, hosts, kubernetes
from .extend import extend
from .origin import Origin
from .resolve import resolve
from .run_loop import run_plan


def main(argv: list[str]) -> int:
    """Run, resume, list or plan. Returns the exit status.

    Raises:
        UserError: anything the user can fix: one line, status 2.
    """
    parser = command_line()
    arguments = parser.parse_args(argv)
    _check(parser, arguments)
    user_code.allow(*arguments.allow)
    own = tuple(arguments.set)
    if arguments.arm is not None and arguments.resume is None:
        # Whatever is done with --set, as on other hosts, is done with an arm.
        arguments.set = [*arms.of_single_run(arguments.arm), *arguments.set]
    if arguments.list:
        shipped = descriptions.shipped()
        width = max(map(len, shipped))
        for name, path in shipped.items():
            print(f"{name:{width}} {Description.load(path).heading}")
        return 0
    if arguments.resume is not None:
        return _resume(arguments)
    if arguments.description is None:
        raise UserError("which description? --list shows those that come with the package")
    return _start(arguments, own)


# What one asks for -> why, and with what it can be asked for: whatever else is given does nothing.
_TOGETHER = {
    "list": ("--list lists what there is", ()),
    "resume": (
        "--resume continues the run as it was begun",
        ("deployments", "track", "prometheus", "view"),
    ),
    "hosts": (
        "--hosts says what each host does",
        ("description", "arm", "set", "seed", "quick", "insecure", "ssh"),
    ),
    "on": (
        "--on starts every part of the run elsewhere",
        ("description", "arm", "set", "seed", "quick", "insecure", "print", "image"),
    ),
}


def _check(parser: Parser, arguments: argparse.Namespace) -> None:
    """Refuse flags that would do nothing. Raises UserError."""
    for asked, (why, beside) in _TOGETHER.items():
        if parser.alone(arguments, asked, why, *beside):
            return
    given = parser.given(arguments)
    if "deployments" in given:
        raise UserError("--deployments extends a run: with --resume; else --set deployment.count=N")
    if "allow" in given and "origin" not in given:
        raise UserError("--allow is for --from: the code that a description names is run anyway")
    if "ssh" in given:
        raise UserError("--ssh needs --hosts FILE: on which hosts?")
    if "seed" in given and "seed" in map(key_of, arguments.set):
        raise UserError("--seed and --set seed are two seeds: leave out one")
    for name in ("print", "image"):
        if name in given:
            raise UserError(f"--{name} needs --on kubernetes")


def _start(arguments: argparse.Namespace, own: tuple[str, ...]) -> int:
    """Begin a run. `own`: the assignments of --set without those of --arm."""
    quick: bool = arguments.quick
    chosen = descriptions.load(arguments.description, arguments.set, arguments.seed, quick)
    idle.check(own, chosen)
    if arguments.origin is not None:
        idle.check_begun(arguments.set)
    team = plan.team_of(chosen)
    if arguments.origin is not None and arguments.role:
        raise UserError("--from is for a run whose processes are all on one machine")
    if arguments.hosts is not None or arguments.on is not None:
        return elsewhere.start(arguments, chosen, team)
    placement = Placement.of(arguments, chosen, team)
    asked = Beside.of(arguments, placement.role)
    origin = Origin.of(arguments.origin, chosen) if arguments.origin else None
    if origin:
        chosen = origin.begun(chosen)
    description = resolve(chosen, data_here=placement.role != "host")
    # A part of a run on several hosts has a folder of its own, also beside a whole run's.
    part = "" if placement.role == "all" else f"-{placement.agent or HOST}"
    quickly = "-quick" if quick else ""
    arm = f"-{arguments.arm}" if arguments.arm else ""
    name = f"{description.name}{arm}{quickly}-seed{description.seed}{part}"
    out: Path = arguments.out or Path("runs") / name
    run = out.name if placement.role == "all" else run_record.shared_name(description)
    planned = plan.make(description, RunFolder(out.resolve()), run, placement, asked)
    preflight.check(planned, out)
    if arguments.dry_run:
        if quick:
            print(descriptions.QUICK_LABEL)
        say(*planned.lines())
        return 0
    if placement.insecure:
        print(hosts.INSECURE, file=sys.stderr)
    if preflight.goes_on(planned):
        with run_record.locked(planned.folder):
            record = run_record.rejoin(planned.folder, description, placement)
            again = plan.make(description, planned.folder, record.run, placement, asked)
            return run_plan(again, record)
    new = new_folder.make_folder(out, planned.disk_bytes)
    folder = RunFolder(new.root)
    with run_record.locked(folder):
        try:
            if origin:
                new.given |= {folder.checkpoint(agent, 0) for agent in origin.policies}
                origin.write(folder, description)
            begun = origin.root if origin else None
            record = run_record.create(folder, description, quick, placement, begun)
        except (UserError, OSError):
            new.take_away()
            raise
        return run_plan(plan.make(description, folder, record.run, placement, asked), record, new)


def _resume(arguments: argparse.Namespace) -> int:
    folder = RunFolder(arguments.resume.resolve())
    with ExitStack() as stack:
        # A folder without a record is not a run's: no lock in it.
        place = run_record.RunRecord.read(folder).place
        asked = Beside.of(arguments, place.role)
        place.check_access()
        stack.enter_context(run_record.locked(folder))
        if arguments.deployments is not None:
            extend(folder, arguments.deployments)
        record, description = run_record.reopen(folder)
        return run_plan(plan.make(description, folder, record.run, record.place, asked), record)


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.launch",
        description="\n".join(
            [
                "Run a launch description: data, offline training, deployments, report.",
                "",
                "other commands, with their own --help:",
                *lines(OF_LAUNCH),
            ]
        ),
        epilog="\n".join(["arms:", *meanings.lines(analyses=False)]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    descriptions.add_flags(parser)
    parser.add_argument(
        "--arm",
        metavar="NAME",
        help="sample as this arm of a comparison does; --set is applied after it; see below",
    )
    parser.add_argument("--seed", type=int, help="the run's seed")
    parser.add_argument("--out", type=Path, help="run folder (default: runs/NAME-seedSEED)")
    parser.add_argument("--resume", type=Path, metavar="RUN", help="continue a run")
    parser.add_argument(
        "--deployments", type=int, metavar="N", help="with --resume: extend it to so many"
    )
    parser.add_argument(
        "--from",
        dest="origin",
        type=Path,
        metavar="RUN",
        help="begin with the offline policies of another run, or of a comparison's seed folder",
    )
    parser.add_argument("--dry-run", action="store_true", help="print what would run, and stop")
    apart = parser.add_argument_group("on several hosts (see docs/hosts.md)")
    apart.add_argument("--role", choices=["host", "learner"], help="start this part only")
    apart.add_argument("--agent", metavar="NAME", help="whose learner, as agent_0")
    apart.add_argument("--listen", metavar="ENDPOINT", help="of the host, as tls/0.0.0.0:7447")
    apart.add_argument("--connect", metavar="ENDPOINT", help="to the host, as tls/192.0.2.1:7447")
    apart.add_argument("--certs", type=Path, metavar="DIR", help="what otc_dist.certs has made")
    apart.add_argument("--insecure", action="store_true", help="no TLS: anyone can read and write")
    apart.add_argument(
        "--hosts",
        type=Path,
        metavar="FILE",
        help="print the command of each host in this TOML file",
    )
    apart.add_argument("--ssh", action="store_true", help="with --hosts: run them there")
    apart.add_argument(
        "--on",
        choices=["slurm", "kubernetes"],
        help="slurm: start every part on a node of the allocation in which this is called;"
        " kubernetes, with --print: print manifests for kubectl",
    )
    apart.add_argument("--print", action="store_true", help="with --on kubernetes: apply nothing")
    apart.add_argument(
        "--image",
        default=kubernetes.IMAGE,
        help="with --on kubernetes: what the pods run (default: %(default)s; see Dockerfile)",
    )
    Beside.add_flags(parser)
    user_code.add_flag(parser)
    parser.add_argument("--list", action="store_true", help="list the shipped descriptions")
    return parser
