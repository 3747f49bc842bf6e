"""`launch mechanism NAME`: do the transitions that OTC selects follow the online dynamics?"""

from contextlib import nullcontext
from pathlib import Path

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison.mechanism import table
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.description import Description, user_code
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser

from ..plan import descriptions
from ..run.resolve import resolve
from ..supervise.processes import MISTAKE
from . import cluster, held_folder, job_graph
from .comparison import check_settings, check_size, label_of

_EXPLANATION = """\
Deploys the offline policies once and asks, of the transitions that each distance selects at
alpha_0: how far are the other agents' recorded actions from what those agents would do now? As a
ratio to uniform sampling, beside an oracle that sorts by this very mismatch. It needs joint data,
which only an analysis sees; no learner does. Far less noisy than returns.
"""


def main(argv: list[str]) -> int:
    """Measure and print. Returns the exit status.

    Raises:
        UserError: anything the user can fix: one line, status 2.
    """
    arguments = command_line().parse_args(argv)
    user_code.allow(*arguments.allow)
    queue = cluster.options(arguments)
    check_settings(arguments.set)
    seeds = arms_of.parse_seeds(arguments.seeds)
    quick: bool = arguments.quick
    started = descriptions.load(arguments.description, (), None, quick)
    default = Path("runs") / f"compare-{started.name}{'-quick' if quick else ''}"
    folder = ComparisonFolder((arguments.checkpoints or default).resolve())
    if arguments.checkpoints and not folder.root.is_dir():
        raise UserError(f"there is no folder {folder.root}; leave --checkpoints out to begin anew")
    if folder.description.exists():
        base = Description.load(folder.description)
        user_code.require(*base.code)  # which those who measure run
        if base.name != started.name:
            raise UserError(f"{folder.root} is of {base.name}, not of {started.name}")
        analysed = base.with_assignments(*arguments.set)
        if analysed.offline_digest() != base.offline_digest():
            raise UserError(
                f"--set would change pi_0, and {folder.root} has its own: leave it out, or use"
                " another --checkpoints"
            )
        if quick and arguments.checkpoints and not _label(folder, base):
            raise UserError(
                f"--quick would change pi_0, and {folder.root} has that of a whole comparison:"
                " leave it out, or use another --checkpoints"
            )
    else:
        base = resolve(descriptions.load(arguments.description, arguments.set, None, quick))
        check_size(base, quick)
        analysed = base
    if len(registry.team_spec(base.env.id).agents) < 2:
        raise UserError(f"the mechanism check is about other agents, and {base.env.id} has none")
    name = analysed.digest()
    jobs = job_graph.mechanism(folder, base, seeds, name, arguments.set)
    if arguments.status:
        held_folder.check(folder, base)
        cluster.show(jobs)
        return 0
    # A comparison may be at work in the folder: it is ours only if something must be trained.
    # Nor do two submit the same jobs.
    trained = queue is None and all(job.done for job in jobs[: -len(seeds)])
    with nullcontext() if trained else held_folder.opened(folder, base, quick) as new:
        if queue is not None and not all(job.done for job in jobs):
            return cluster.submit(jobs, queue)
        if new:
            new.given |= job_graph.outputs(jobs, folder.root)
        patience = base.bus.answer_deadline
        if status := job_graph.do(jobs, [folder], patience, lambda job: None):
            if new and status == MISTAKE:
                new.take_away()
            return status
    if label := _label(folder, base):
        print(label)
    found = table.read([folder.mechanism(name, seed) for seed in seeds])
    print("\n".join(found.lines()))
    return 0


def _label(folder: ComparisonFolder, base: Description) -> str:
    return label_of(folder.quick.exists(), base.evaluation.episodes)


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.launch mechanism", description=_EXPLANATION, allow_abbrev=False
    )
    descriptions.add_flags(parser, required=True)
    parser.add_argument("--seeds", default="0..2", help="0..2 or 0,1,5 (default: %(default)s)")
    parser.add_argument(
        "--checkpoints",
        type=Path,
        metavar="DIR",
        help="a comparison's folder: its offline policies are used, and missing ones are trained"
        " there, which takes as long as offline training (default: runs/compare-NAME)",
    )
    cluster.add_flags(parser)
    user_code.add_flag(parser)
    return parser
