"""`otc-dist COMMAND ...`, or `python -m otc_dist COMMAND ...`: all commands by one name."""

import argparse
import sys
from importlib import import_module
from pathlib import Path

from otc_dist import __version__
from otc_dist.terminal.commands import COMMANDS, lines
from otc_dist.terminal.errors import UserError, run_main, unknown
from otc_dist.terminal.parser import Parser

SHELLS = ("bash", "zsh", "tcsh")


def main(argv: list[str]) -> int:
    """Run a command; returns its exit status. Raises UserError for the user's mistakes."""
    first, rest = (argv[0], argv[1:]) if argv else ("", [])
    if first in COMMANDS:
        command = COMMANDS[first]
        words = [*filter(None, (command.word,)), *rest]
        sys.argv[1:] = words  # a run notes how it was begun, and chaos begins itself anew
        status: int = import_module(command.module).main(words)
        return status
    if first and not first.startswith("-"):
        raise unknown("command", first, COMMANDS)
    parser = command_line()
    shell: str | None = parser.parse_args(argv).print_completion
    if shell is None:
        parser.print_help()
    else:
        print(_completion(shell))
    return 0


def command_line() -> Parser:
    """The parser of what comes before a command."""
    parser = Parser(
        prog="otc-dist",
        usage="otc-dist [-h] [--version] [--print-completion SHELL] COMMAND ...",
        description="commands, each with its own --help:\n" + "\n".join(lines(COMMANDS)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"otc-dist {__version__}")
    parser.add_argument(
        "--print-completion",
        choices=SHELLS,
        metavar="SHELL",
        help=f"print what completes commands and flags in {', '.join(SHELLS)}",
    )
    return parser


def _completion(shell: str) -> str:
    """A script for the shell, from the parsers of all commands."""
    try:
        import shtab
    except ImportError:
        raise UserError(
            f"completion needs the package shtab: {sys.executable} -m pip install shtab"
        ) from None
    whole = command_line()
    below = whole.add_subparsers(metavar="COMMAND")
    for name, command in COMMANDS.items():
        own: Parser = import_module(command.parser or command.module).command_line()
        for action in own.actions():
            if action.type is Path:
                action.complete = shtab.FILE  # type: ignore[attr-defined]  # shtab reads it
        below.add_parser(name, help=command.help, parents=[own], add_help=False)
    return shtab.complete(whole, shell)


def entry() -> None:
    """The console script."""
    run_main(main)


if __name__ == "__main__":
    entry()
