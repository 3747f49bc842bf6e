"""`python -m otc_dist.report RUN [RUN ...]`."""

from pathlib import Path

from otc_dist.errors import run_main
from otc_dist.parser import Parser
from otc_dist.report.write import write_report
from otc_dist.run_folder import RunFolder


def main(argv: list[str]) -> int:
    """Write the report of each run folder and print where it is."""
    parser = Parser(
        prog="python -m otc_dist.report",
        description="Write results.json and report.html of runs, finished or not.",
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="a run folder")
    for root in parser.parse_args(argv).runs:
        print(write_report(RunFolder(root)))
    return 0


if __name__ == "__main__":
    run_main(main)
