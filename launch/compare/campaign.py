"""`launch campaign NAME`: the comparisons that a file lists, together and seed by seed."""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from otc_dist.comparison import arms as arms_of
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.comparison.spent import Spent
from otc_dist.system import durable
from otc_dist.terminal.amounts import duration
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser, check_ending
from otc_dist.terminal.printable import aligned, say

from ..plan import descriptions
from ..supervise import job_order
from ..supervise.jobs import Job, cores
from . import campaign_file, cluster, comparison, held_folder, rates
from .campaign_file import Campaign
from .campaign_results import PAGE, Results
from .comparison import Comparison

CLUSTER = 64  # cores for which the forecast says the time as well
_MEASURED = "by the processor time that jobs took which are done"
_UNMEASURED = (
    "by rates of another machine: no job that is done says what it took, and machines differ by"
    " more than a factor of two"
)

_EXPLANATION = """\
Does every comparison that a TOML file lists, as `compare` does one: the first seed of all, then the
second, so that whatever time allows are complete seeds of all. The same command continues where it
was stopped, and takes more seeds later. Each comparison has its folder in OUT, named after its
description, its data and its part of the file, with raw scores and a page of tables;
OUT/campaign.html has all of them together, rewritten whenever a seed of all is complete.
"""


def main(argv: list[str]) -> int:
    """Do a campaign, or say what it would cost, or what it has found. Returns the exit status.

    Raises:
        UserError: anything the user can fix: one line, status 2.
    """
    parser = command_line()
    arguments = parser.parse_args(argv)
    if parser.alone(arguments, "tables", "--tables shows what is in its folder", "page"):
        if arguments.page is not None:
            check_ending("--page", arguments.page, ".html")
        shown = Results.read(arguments.tables)
        if arguments.page is not None:
            durable.put(arguments.page, shown.page().encode())
        if names := ", ".join(path.name for path in shown.left_out):
            say(f"of no campaign, and left out: {names}", file=sys.stderr)
        say(*shown.text())
        return 0
    if arguments.page is not None:
        raise UserError("--page is made of what --tables shows: give both")
    if arguments.campaign is None:
        shipped = ", ".join(campaign_file.shipped())
        raise UserError(
            f"which campaign? A TOML file, or one that comes with the package: {shipped}"
        )
    does = ("campaign", "out", "seeds", "quick")
    parser.alone(arguments, "dry_run", "--dry-run does nothing", *does)
    queue = cluster.options(arguments)
    path = campaign_file.find(arguments.campaign)
    campaign = Campaign.load(path)
    quick: bool = arguments.quick
    name = f"campaign-{path.stem}{'-quick' if quick else ''}"
    root = (arguments.out or Path("runs") / name).resolve()
    if ComparisonFolder(root).description.exists():
        raise UserError(f"{root} is the folder of a comparison or a run; use another --out")
    results: Path | None = arguments.results
    _check_listed(path, campaign, root if results is None else results, root)
    asked = None if arguments.seeds is None else arms_of.parse_seeds(arguments.seeds)
    try:
        seeds = arms_of.parse_seeds(campaign.seeds) if asked is None else asked
        comparisons = [
            Comparison(
                ComparisonFolder(root / one.name),
                one.base,
                one.arms,
                seeds,
                quick,
                results and results / one.name,
                one.name,
            )
            for one in campaign.comparisons(quick)
        ]
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    if arguments.dry_run or arguments.status:
        for one in comparisons:
            held_folder.check(one.folder, one.base)
    if arguments.dry_run:
        durable.room_for(root)
        say(*_forecast(comparisons, seeds))
        return 0
    if arguments.status:
        cluster.show(comparison.jobs_of(comparisons))
        return 0

    def whole() -> None:
        """Show all of them together; the file lies beside the scores, to say what they are of."""
        if not any(root.glob("*/description.toml")):
            return  # nothing could be done
        for folder in (root, *([] if results is None else [results])):
            durable.put(folder / path.name, path.read_bytes())
        shown = Results.read(root)
        if shown.found:
            durable.put(root / PAGE, shown.page().encode())

    status = comparison.carry_out(root, comparisons, queue, whole)
    if (root / PAGE).exists():
        say(f"all together: {root / PAGE}")
    return status


def _check_listed(path: Path, campaign: Campaign, *folders: Path) -> None:
    """Raises UserError: a copy of its file would replace another campaign's of the same name."""
    for there in (folder / path.name for folder in folders):
        if there.exists() and not there.samefile(path):
            lost = set(Campaign.load(there).parts) - set(campaign.parts)
            if lost:
                raise UserError(
                    f"{there} lists {min(lost)} as well, which {path} does not, and would be"
                    " replaced by it: rename one of them, or use another folder"
                )


def _forecast(comparisons: Sequence[Comparison], seeds: Sequence[int]) -> Iterator[str]:
    """What is to be done, and how long it takes by what took how long, or a run's forecast."""
    yield f"seeds {', '.join(map(str, seeds))}: each of all comparisons before the next"
    forecast = comparison.jobs_of(comparisons)
    took = rates.read(forecast)
    jobs = rates.measured(comparisons, forecast, took)
    rows = [("comparison", "jobs", "took", "to do", "core hours", "arms")]
    for one in comparisons:
        own = [job for job in jobs if job.output.is_relative_to(one.folder.root)]
        rows.append((one.name, *_amounts(own, took), ", ".join(one.arms)))
    rows.append(("in all", *_amounts(jobs, took), ""))
    *numbers, arms = zip(*rows, strict=True)
    left = max(map(len, arms))
    table = aligned(zip(*numbers, (one.ljust(left) for one in arms), strict=True), str.rjust)
    yield from (line.rstrip() for line in table)
    todo = [job for job in jobs if not job.done]
    longest = max(job_order.chains(todo).values(), default=0.0)
    total = sum(job.seconds for job in todo)
    yield _MEASURED if took else _UNMEASURED
    for count, where in ((cores(), "this machine"), (CLUSTER, "a cluster")):
        yield f"about {duration(max(total / count, longest))} on {where}, {count} cores"


def _amounts(jobs: Sequence[Job], took: Mapping[Path, Spent]) -> tuple[str, str, str, str]:
    """How many jobs, the hours of one core that those took which are done, how many are left, and
    the hours that these take.
    """
    todo = [job for job in jobs if not job.done]
    hours = sum(job.seconds for job in todo) / 3600
    return f"{len(jobs):,}", f"{rates.hours(jobs, took):,.1f}", f"{len(todo):,}", f"{hours:,.1f}"


def command_line() -> Parser:
    """The parser of the command's arguments."""
    shipped = campaign_file.shipped().items()
    rows = [(f"  {name}", Campaign.load(path).summary) for name, path in shipped]
    parser = Parser(
        prog="python -m otc_dist.launch campaign",
        description=_EXPLANATION,
        epilog="\n".join(
            [
                "a campaign's file, whose keys are named after the flags of `compare`:",
                campaign_file.FORM,
                "campaigns that come with the package:",
                *aligned(rows),
            ]
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("campaign", nargs="?", help="a shipped campaign's name, or a TOML file")
    parser.add_argument("--seeds", help="0..9 or 0,1,5 (default: those in the file)")
    parser.add_argument("--out", type=Path, help="folder (default: runs/campaign-NAME)")
    parser.add_argument(
        "--results",
        type=Path,
        metavar="FOLDER",
        help="copy the raw scores of every seed that is complete to a folder in there, to be kept",
    )
    parser.add_argument(
        "--tables",
        type=Path,
        metavar="FOLDER",
        help="run nothing: print all tables of the raw scores in a campaign's folder, or in one"
        " that --results made",
    )
    parser.add_argument(
        "--page",
        type=Path,
        metavar="FILE.html",
        help="with --tables: write the page of them, with curves",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="run nothing: print the comparisons, how many jobs are to be done, and the hours",
    )
    parser.add_argument("--quick", action="store_true", help=descriptions.QUICK_HELP)
    cluster.add_flags(parser)
    return parser
