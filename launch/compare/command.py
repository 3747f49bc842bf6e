"""`launch compare NAME`: tune several arms from the same offline policies, and compare them."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison import collected, meanings, report, tables
from otc_dist.comparison.arms import Arms
from otc_dist.comparison.picture import picture
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import ComparisonFolder, Run
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import say

from ..plan import descriptions
from ..run.resolve import resolve
from ..supervise.jobs import Job
from . import cluster, job_graph

SEEDS = "0..9"
_SHOWN = ("tables", "picture")  # what goes together
EPISODES = 30  # greedy episodes that a comparison needs at least

_EXPLANATION = """\
Trains the offline policies of every seed once, tunes every arm from them with common random
numbers, and compares the arms on the same greedy episodes. Raw scores are in OUT/seeds; the result
is in OUT/comparison.html and OUT/comparison.json, rewritten whenever a seed is complete. The same
command continues where it was stopped; more seeds or more arms may be asked for later.
"""


def main(argv: list[str]) -> int:
    """Compare arms. Returns the exit status.

    Raises:
        UserError: anything the user can fix: one line, status 2.
    """
    parser = command_line()
    arguments = parser.parse_args(argv)
    if arguments.picture is not None and arguments.tables is None:
        raise UserError("--picture draws what --tables shows: give both")
    if arguments.tables is not None:
        if idle := [flag for name, flag in parser.given(arguments).items() if name not in _SHOWN]:
            raise UserError(f"--tables shows what is in its folder: leave out {idle[0]}")
        return _show(arguments)
    if arguments.description is None:
        raise UserError("compare which description? Or --tables FOLDER, of one that was compared")
    seeds = arms_of.parse_seeds(SEEDS if arguments.seeds is None else arguments.seeds)
    quick: bool = arguments.quick
    loaded = descriptions.load(arguments.description, arguments.set, None, quick)
    names = arms_of.usual(loaded) if arguments.arms is None else arguments.arms
    arms = arms_of.parse_arms(names, arguments.arm)
    base = resolve(loaded)
    _check(base, arms, quick)
    name = f"compare-{base.name}{'-quick' if quick else ''}"
    folder = ComparisonFolder((arguments.out or Path("runs") / name).resolve())
    queue = cluster.options(arguments)
    if arguments.status:
        cluster.show(job_graph.comparison(folder, base, arms, seeds))
        return 0
    with job_graph.opened(folder, base):
        return _compare(folder, base, arms, seeds, quick, arguments.results, queue)


def _show(arguments: argparse.Namespace) -> int:
    """Print the tables of a folder of raw scores."""
    found = collected.collect(arguments.tables)
    label = f" ({descriptions.QUICK_LABEL})" if found.episodes < EPISODES else ""
    say(f"{found.name}, {found.dataset}{label}; on {tables.processors(found.runs)}")
    say(*tables.text(summarise(found.runs, found.normalise)))
    if arguments.picture is not None:
        seeds = max(len(of_arm) for of_arm in found.runs.values())
        over = "1 seed" if seeds == 1 else f"mean ± standard error of {seeds} seeds"
        title = f"{found.dataset}: the recommended policy, {over}"
        try:
            arguments.picture.write_text(picture(found.runs, title), encoding="utf-8")
        except OSError as error:
            raise UserError(f"cannot write {arguments.picture}: {error.strerror}") from None
    return 0


def _check(base: Description, arms: Arms, quick: bool) -> None:
    if base.evaluation.episodes < EPISODES and not quick:
        raise UserError(
            f"a comparison needs evaluation.episodes >= {EPISODES}, not"
            f" {base.evaluation.episodes}: returns are too noisy (--quick allows fewer, as a look)"
        )
    if not base.deployment.count:
        raise UserError("a comparison needs deployment.count >= 1: otherwise nothing is tuned")
    arms_of.check(base, arms)


def _compare(
    folder: ComparisonFolder,
    base: Description,
    arms: Arms,
    seeds: Sequence[int],
    quick: bool,
    results: Path | None,
    queue: tuple[str, ...] | None,
) -> int:
    """Do the jobs: on this machine, or, where `queue` has options for it, in SLURM's queue."""
    if results is not None:  # a mistake shows before anything runs
        collected.keep(folder, (), (), results)
    if taken := job_graph.take_offline(folder, base, arms, seeds):
        say(f"{taken} offline policies are those that an earlier comparison trained")
    jobs = job_graph.comparison(folder, base, arms, seeds)
    left = sum(not job.done for job in jobs)
    say(f"{folder.root}: {len(jobs)} jobs, {left} of them to do")
    if queue is not None:
        status = cluster.submit(jobs, queue) if left else 0
        _conclude(folder, base, arms, seeds, quick, results)
        return status
    complete = len(_complete(folder, arms, seeds))

    def finished(job: Job) -> None:
        """Show the result so far whenever one more seed is complete for all arms."""
        nonlocal complete
        if job is jobs[0]:  # the data have been made
            job_graph.note_inputs(folder, base)
        if len(_complete(folder, arms, seeds)) > complete:
            complete += 1
            _conclude(folder, base, arms, seeds, quick, results)

    status = job_graph.do(jobs, folder, base, finished)
    if not left or status:  # else it was shown when the last job finished
        _conclude(folder, base, arms, seeds, quick, results)
    return status


def _complete(folder: ComparisonFolder, arms: Arms, seeds: Sequence[int]) -> list[int]:
    """The seeds for which every arm has its run."""
    return [seed for seed in seeds if all(folder.run(seed, arm).exists() for arm in arms)]


def _conclude(
    folder: ComparisonFolder,
    base: Description,
    arms: Arms,
    seeds: Sequence[int],
    quick: bool,
    results: Path | None,
) -> None:
    """Print and write what the complete seeds show, and copy their raw scores to `results`."""
    complete = _complete(folder, arms, seeds)
    if not complete:
        print(f"no seed is complete for all of {', '.join(arms)} yet")
        return
    if results is not None:
        collected.keep(folder, arms, complete, results)
    runs = {arm: [Run.read(folder.run(seed, arm)) for seed in complete] for arm in arms}
    summary = summarise(runs, lambda value: registry.normalised_score(base.env.id, value))
    label = descriptions.QUICK_LABEL if quick else ""
    report.write(folder, base, arms, summary, runs, label)
    of_all = "" if len(complete) == len(seeds) else f" of {len(seeds)}: so far"
    count = f"{len(complete)} complete {'seed' if len(complete) == 1 else 'seeds'}"
    print(f"\n{count}{of_all}{f' ({label})' if label else ''}")
    say(*tables.text(summary))
    print(f"report: {folder.report}\n", flush=True)


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.launch compare",
        description=_EXPLANATION,
        epilog="\n".join(["arms:", *meanings.lines(analyses=True)]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "description", nargs="?", help="a shipped description's name, or a TOML file"
    )
    parser.add_argument(
        "--arms",
        metavar="NAME,NAME",
        help=f"arms to compare, of those below; {arms_of.REFERENCE} and {arms_of.NULL} are always"
        f" among them (default: {', '.join(arms_of.USUAL)})",
    )
    parser.add_argument(
        "--arm",
        action="append",
        default=[],
        metavar="NAME=section.key=value,...",
        help="one more arm of your own, like mild=sampling.name=otc,sampling.alpha=0.5; one that"
        " changes algorithm.* or offline.* trains a pi_0 of its own",
    )
    parser.add_argument("--seeds", help=f"0..9 or 0,1,5 (default: {SEEDS}; ten for any claim)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="section.key=value",
        help="change one value for all arms",
    )
    parser.add_argument("--out", type=Path, help="folder (default: runs/compare-NAME)")
    parser.add_argument(
        "--results",
        type=Path,
        metavar="FOLDER",
        help="copy the raw scores of every seed that is complete there, to be kept",
    )
    parser.add_argument(
        "--tables",
        type=Path,
        metavar="FOLDER",
        help="run nothing: print all tables of the raw scores in a comparison's folder, or in one"
        " that --results made",
    )
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE.svg",
        help="with --tables: draw what is recommended after each deployment",
    )
    parser.add_argument("--quick", action="store_true", help=descriptions.QUICK_HELP)
    cluster.add_flags(parser)
    return parser
