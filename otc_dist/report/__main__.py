"""`python -m otc_dist.report RUN [RUN ...]`."""

from importlib import import_module
from pathlib import Path

from otc_dist.report.write import write_report
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import run_main
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import say


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.report",
        description="Write results.json and report.html of runs, finished or not; of comparisons,"
        " comparison.json and comparison.html.",
    )
    parser.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="a run's folder, or a comparison's"
    )
    return parser


def main(argv: list[str]) -> int:
    """Write the report of each run or comparison, and print where it is."""
    # By name: reports of runs know nothing of comparisons, which are made of runs.
    again = import_module("otc_dist.comparison.again")
    roots: list[Path] = command_line().parse_args(argv).runs
    for folder in map(RunFolder, roots):  # a mistake in one before any is written
        if not folder.description.exists():
            raise folder.lacks(folder.description)
        again.check(folder.root)
    for root in roots:
        write = again.write_again if again.is_comparison(root) else write_report
        say(write(RunFolder(root)))
    return 0


if __name__ == "__main__":
    run_main(main)
