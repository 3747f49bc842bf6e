"""The command `python -m otc_dist.replay FILE...`: look at deployment logs, and use them."""

import argparse
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from otc_dist.deployment_log.format import DamagedLogError
from otc_dist.description import user_code
from otc_dist.replay.export.formats import FORMATS
from otc_dist.replay.output import ended_in_order
from otc_dist.replay.selection import step_range
from otc_dist.terminal.errors import UserError, run_main
from otc_dist.terminal.parser import Parser, check_ending

DESCRIPTION = """\
Deployment logs (MCAP): what is in them, whether it is true, and what to make of it. Without an
action, a summary of each FILE, finished or not.
"""
EXAMPLES = """\
examples:
  python -m otc_dist.replay runs/3agent_hopper-seed0/deployments/*.mcap
  python -m otc_dist.replay deployment_01.mcap --steps 100:200 --agent agent_1
  python -m otc_dist.replay deployment_01.mcap --verify
  python -m otc_dist.replay deployment_01.mcap --export parquet --out exported
  python -m otc_dist.replay hopper-3x1/medium --export vault --out exported
  python -m otc_dist.replay runs/3agent_hopper-seed0/deployments/*.mcap --publish --rate 10
  python -m otc_dist.replay deployment_01.mcap --html page.html
  python -m otc_dist.replay deployment_01.mcap --episode 3 --video film.mp4
  python -m otc_dist.replay damaged.mcap --recover --out whole.mcap

exit status: 0 all is well; 1 --verify found something wrong, --recover something missing, or a
learner that --publish asked acts differently from the log; 2 a mistake to fix; 3 --verify in
another version of the simulator, where bits may differ; 4 --verify of a log of the older form,
whose steps do not say which run they are from.
"""


@dataclass(frozen=True)
class _Action:
    """An action: its flag, the module here whose `run(arguments)` does it, and its help.

    The module is imported only when the action is asked for. `metavar`: of the flag's value, if
    it takes one.
    """

    flag: str
    module: str
    help: str
    metavar: str | None = None
    choices: Sequence[str] | None = None

    def add_to(self, group: "argparse._MutuallyExclusiveGroup") -> None:
        if self.metavar is None:
            group.add_argument(self.flag, action="store_true", help=self.help)
        else:
            group.add_argument(
                self.flag, metavar=self.metavar, choices=self.choices, help=self.help
            )

    @property
    def name(self) -> str:
        return self.flag.removeprefix("--").replace("-", "_")


_ACTIONS: tuple[_Action, ...] = (
    _Action(
        "--export",
        "export.command",
        f"data sets for other tools, in the folder --out: {', '.join(FORMATS)}",
        metavar="FORMAT",
        choices=tuple(FORMATS),
    ),
    _Action("--video", "video", "a film of its best and its worst episode", metavar="OUT.mp4"),
    _Action(
        "--sheet",
        "sheet",
        "pictures of its best and its worst episode on one sheet",
        metavar="OUT.png",
    ),
    _Action(
        "--foxglove",
        "foxglove",
        "what Foxglove shows of it, alpha and 𝔻 besides",
        metavar="OUT.mcap",
    ),
    _Action("--html", "html", "one page that plays it in any browser", metavar="OUT.html"),
    _Action("--verify", "verify", "check it, and play it again: every bit must come out as logged"),
    _Action("--publish", "publish", "put a run's logs on the bus again, under its keys"),
    _Action("--recover", "recover", "write what is whole of a damaged or unfinished log anew"),
)


# Flags that are not for every action -> those for which they are. "": without an action.
_PICTURES = ("--video", "--sheet", "--html")
_PARTS = ("", "--export", *_PICTURES, "--verify", "--publish")
_ONLY_FOR = {
    "steps": _PARTS,
    "agent": _PARTS,
    "episode": (*_PARTS, "--foxglove"),
    "transitions": ("--export",),
    "accept_unbound": ("--verify",),
    "run": ("--publish",),
    "rate": ("--publish",),
    "learners": ("--publish",),
    "out": ("--export", "--recover"),
    "force": ("--export", *_PICTURES, "--foxglove", "--recover"),
}


def main(argv: list[str]) -> int:
    """Run one action; its exit status. Raises UserError for what the user can fix."""
    parser = command_line()
    arguments = parser.parse_args(argv)
    chosen = next((a for a in _ACTIONS if getattr(arguments, a.name)), None)
    _check(parser.given(arguments), chosen, arguments)
    user_code.allow(*arguments.allow)
    module = import_module(f"otc_dist.replay.{chosen.module if chosen else 'summary'}")
    try:
        with ended_in_order():
            status: int = module.run(arguments)
    except DamagedLogError as error:
        raise UserError(f"{error}; --recover writes what is whole to another file") from None
    return status


def _check(given: Mapping[str, str], action: _Action | None, arguments: argparse.Namespace) -> None:
    """Refuse flags that would do nothing, and files whose name says that they are another kind."""
    chosen = action.flag if action else ""
    for name, flag in given.items():
        uses = _ONLY_FOR.get(name, (chosen,))
        if chosen not in uses:
            when = f"with {chosen}" if chosen else "without an action"
            them = ", ".join(filter(None, uses))
            raise UserError(f"{flag} does nothing {when}; it is for {them}: leave it out")
    if action and action.metavar and action.metavar.startswith("OUT"):
        out = Path(getattr(arguments, action.name))
        check_ending(chosen, out, Path(action.metavar).suffix)


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.replay",
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="a deployment log (.mcap, .partial); or, for --export, one data set of the cache,"
        " by its name, as hopper-3x1/medium",
    )
    user_code.add_flag(parser)
    actions = parser.add_mutually_exclusive_group()
    for action in _ACTIONS:
        action.add_to(actions)

    part = parser.add_argument_group("which part of the logs (the rest is not read)")
    part.add_argument(
        "--steps", type=step_range, metavar="A:B", help="steps A to B - 1, as 100:200 or 100:"
    )
    part.add_argument("--episode", type=int, metavar="N", help="one episode, counted from 0")
    part.add_argument(
        "--agent", action="append", metavar="NAME", help="one agent; may be given again"
    )

    part.add_argument(
        "--transitions", type=int, metavar="N", help="of a data set: its size, if not the usual one"
    )

    check = parser.add_argument_group("how strictly it is verified")
    check.add_argument(
        "--accept-unbound",
        action="store_true",
        help="take a log of the older form, whose steps name no run: you know where it is from",
    )

    bus = parser.add_argument_group("how logs are published")
    bus.add_argument(
        "--run", type=Path, metavar="DIR", help="on this run folder's bus (default: the logs')"
    )
    bus.add_argument(
        "--rate", type=_rate, metavar="X", help="X times as fast as recorded (default: 1)"
    )
    bus.add_argument(
        "--learners",
        action="store_true",
        help="ask the agents' learners, which tune as those did that were there, and wait for the"
        " slowest; with --rate, not faster than that",
    )

    output = parser.add_argument_group("what is written")
    output.add_argument("--out", type=Path, metavar="PATH", help="where to")
    output.add_argument("--force", action="store_true", help="replace what is there")
    return parser


def _rate(text: str) -> float:
    with suppress(ValueError):
        if 0 < float(text) < float("inf"):
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")


if __name__ == "__main__":
    run_main(main)
