"""The command `python -m otc_dist.certs`: certificates for a run on several hosts."""

import argparse
import json
from pathlib import Path

from otc_dist.bus.access import router_rules
from otc_dist.bus.keys import ANY, Keys
from otc_dist.certs.authority import make, own_names
from otc_dist.names import is_name
from otc_dist.terminal.errors import UserError, run_main
from otc_dist.terminal.parser import Parser

DESCRIPTION = """\
Make what processes on separate hosts prove with who they are: a certificate authority, and one
certificate and key for the env host, for each learner, and for an observer.

Certificates that are there and still valid are kept, so the command can be given again, with more
agents or when some have expired. To begin anew, delete DIR.
"""
EXAMPLES = """\
examples:
  python -m otc_dist.certs certs --agents 3
  python -m otc_dist.certs certs --agents 3 --host learners.example.org --host 192.0.2.1
  scp -r certs/agent_1 B:certs/          all that the host of agent_1's learner needs
"""


def main(argv: list[str]) -> int:
    """Make certificates. Raises UserError for what the user can fix."""
    parser = command_line()
    arguments = parser.parse_args(argv)
    if arguments.rules:
        if not is_name(arguments.rules):
            raise UserError(f"--rules {arguments.rules!r} is not a valid run name")
        parser.alone(arguments, "rules", "--rules makes no certificates", "folder", "agents")
    if arguments.agents < 1 or arguments.days < 1:
        raise UserError("--agents and --days must be 1 or more")
    agents = [f"agent_{index}" for index in range(arguments.agents)]
    if arguments.rules:
        rules = router_rules(Keys(arguments.rules, ANY), agents)
        print(json.dumps({"access_control": rules}, indent=1))
        return 0
    for line in make(arguments.folder, agents, arguments.host or own_names(), arguments.days):
        print(line)
    return 0


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.certs",
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="where they are, or will be")
    parser.add_argument(
        "--agents", type=int, required=True, metavar="N", help="learners: agent_0 .. agent_(N-1)"
    )
    parser.add_argument(
        "--host",
        action="append",
        metavar="NAME",
        help="name or address by which learners reach the env host, once for each"
        " (default: this machine's)",
    )
    parser.add_argument(
        "--rules",
        metavar="RUN",
        help="only print what a Zenoh router of your own may let through of the run of that name:"
        " a part of its configuration",
    )
    parser.add_argument("--days", type=int, default=365, help="how long they are valid")
    return parser


if __name__ == "__main__":
    run_main(main)
