"""`python -m otc_dist.track RUN --to TRACKER`."""

import os
import signal
import sys
import threading
from pathlib import Path

from otc_dist.run.folder import RunFolder, holding
from otc_dist.terminal.errors import UserError, run_main
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import printable, say
from otc_dist.track import trackers

_NICENESS = 10  # a run that goes on comes first


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.track",
        description="Write a run, finished or not, to a tracker: every agent's metrics, the greedy"
        " returns, what the deployments measured, and the settings. Done again, it adds what is"
        " new, and each point is there once.",
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the run's folder")
    parser.add_argument(
        "--to", required=True, choices=sorted(trackers.TRACKERS), help="which tracker"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="its folder (default: RUN/tracking/TRACKER)"
    )
    parser.add_argument(
        "--follow", action="store_true", help="continue until the run ends, or Ctrl-C"
    )
    return parser


def main(argv: list[str]) -> int:
    """Write a run to a tracker; 1 if something damaged had to be left out.

    Raises:
        OSError, UserError: see `write`; `--out` is among a run's own files; or the tracker's
            packages are not installed.
    """
    arguments = command_line().parse_args(argv)
    trackers.check_installed(arguments.to)
    ended = None
    if arguments.follow:
        ended = threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: ended.set())
        os.nice(_NICENESS)
    from otc_dist.track.write import write  # only now, so that a signal that comes soon is heeded

    folder = RunFolder(arguments.run.resolve())
    out: Path = (arguments.out or folder.tracking(arguments.to)).resolve()
    held_by = holding(out)
    if held_by and not out.is_relative_to(RunFolder(held_by).tracking("")):
        raise UserError(
            f"{out} is in the folder of a run or a comparison: without --out its own place is"
            f" {folder.tracking(arguments.to)}"
        )
    left_out = write(folder, arguments.to, out, ended)
    for problem in left_out:
        say(printable(f"left out: {problem}"), file=sys.stderr)
    say(f"{out}; to look at it: {trackers.TRACKERS[arguments.to].look.format(folder=out)}")
    return 1 if left_out else 0


if __name__ == "__main__":
    run_main(main)
