"""`launch compare NAME`: tune several arms from the same offline policies, and compare them."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison import collected, meanings, tables
from otc_dist.comparison.collected import Collected
from otc_dist.comparison.picture import picture
from otc_dist.comparison.score_statistics import summarise
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.system import durable
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser, check_ending
from otc_dist.terminal.printable import say

from ..plan import descriptions, idle
from . import cluster, comparison, held_folder
from .comparison import Comparison

SEEDS = "0..9"

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
    if parser.alone(arguments, "tables", "--tables shows what is in its folder", "picture"):
        return _show(arguments)
    if arguments.picture is not None:
        raise UserError("--picture draws what --tables shows: give both")
    if arguments.description is None:
        raise UserError("compare which description? Or --tables FOLDER, of one that was compared")
    queue = cluster.options(arguments)
    comparison.check_settings(arguments.set)
    seeds = arms_of.parse_seeds(SEEDS if arguments.seeds is None else arguments.seeds)
    quick: bool = arguments.quick
    loaded = descriptions.load(arguments.description, arguments.set, None, quick)
    base, arms = comparison.prepare(loaded, arguments.arms, arguments.arm, quick)
    own = [text.partition("=")[0] for text in arguments.arm]
    idle.check_compared(arguments.set, loaded, arms, own)
    name = f"compare-{base.name}{'-quick' if quick else ''}"
    folder = ComparisonFolder((arguments.out or Path("runs") / name).resolve())
    one = Comparison(folder, base, arms, seeds, quick, arguments.results)
    if arguments.status:
        held_folder.check(folder, base)
        cluster.show(comparison.jobs_of([one]))
        return 0
    return comparison.carry_out(folder.root, [one], queue)


def _show(arguments: argparse.Namespace) -> int:
    """Print the tables of a folder of raw scores."""
    if arguments.picture is not None:
        check_ending("--picture", arguments.picture, ".svg")
    found = collected.collect(arguments.tables)
    if arguments.picture is not None:
        seeds = max(len(of_arm) for of_arm in found.runs.values())
        over = "1 seed" if seeds == 1 else f"mean ± standard error of {seeds} seeds"
        title = f"{found.dataset}: the recommended policy, {over}"
        durable.put(arguments.picture, picture(found.runs, title).encode())
    say(*lines(found))
    return 0


def lines(found: Collected) -> Iterator[str]:
    """What raw scores are of, and all their tables."""
    label = comparison.label_of(found.quick, found.episodes)
    of = f"{found.name}, {found.dataset}{label and f' ({label})'}"
    yield f"{of}; on {tables.processors(found.runs)}"
    yield from tables.text(summarise(found.runs, found.normalise))


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.launch compare",
        description=_EXPLANATION,
        epilog="\n".join(["arms:", *meanings.lines(analyses=True)]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    descriptions.add_flags(parser)
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
        help="one more arm of your own, like strict=sampling.name=otc,sampling.share=0.02; one that"
        " changes algorithm.* or offline.* trains a pi_0 of its own",
    )
    parser.add_argument("--seeds", help=f"0..9 or 0,1,5 (default: {SEEDS}; ten for any claim)")
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
    cluster.add_flags(parser)
    return parser
