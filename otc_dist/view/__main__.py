"""`python -m otc_dist.view RUN`."""

import os
import signal
import threading
from pathlib import Path

from otc_dist.run.folder import RunFolder
from otc_dist.system.ports import Port
from otc_dist.terminal.errors import run_main
from otc_dist.terminal.parser import Parser

PORT = "8700"
_NICENESS = 19  # a run that goes on comes first: on a core that it keeps busy we have a hundredth


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.view",
        description="Show a run's newest deployment in a browser, as it goes on, until Ctrl-C. It"
        " reads the log, which is written ahead: the run knows nothing of it.",
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the run's folder")
    parser.add_argument(
        "--at",
        default=PORT,
        metavar="[HOST:]PORT",
        help="where the page is (default: %(default)s; HOST: the loopback)",
    )
    return parser


def main(argv: list[str]) -> int:
    """Serve the page until somebody ends it. Returns the exit status.

    Raises:
        UserError: no run's folder, nothing to be seen in it, or nobody can listen there.
    """
    arguments = command_line().parse_args(argv)
    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.set())
    from otc_dist.view.server import serve  # only now, so that a signal that comes soon is heeded

    os.nice(_NICENESS)
    serve(RunFolder(arguments.run.resolve()), Port.parse(arguments.at), over)
    return 0


if __name__ == "__main__":
    run_main(main)
