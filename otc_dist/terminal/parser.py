"""The argument parser of all commands."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from otc_dist.terminal.errors import UserError, unknown

_EMPTY = "nothing is given"  # as by --out "$UNSET"


def _whole(text: str) -> int:
    """What `type=int` is here."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def _path(text: str) -> Path:
    """What `type=Path` is here: an empty one would be the current folder."""
    if not text:
        raise argparse.ArgumentTypeError(_EMPTY)
    return Path(text)


def check_ending(flag: str, out: Path, ending: str) -> None:
    """Raises UserError: by its name a file is of another kind than what the flag writes."""
    if out.suffix.lower() not in ("", ending):
        raise UserError(f"{flag} writes {ending}, and {out} ends differently")


class _Once(argparse.Action):
    """Keeps the value of an option, and refuses a second one: one of the two would be lost."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        assert isinstance(parser, Parser)
        if self.option_strings and self.dest in parser.met:
            parser.error(f"{option_string} is given twice, and takes one value")
        if values == "":
            raise argparse.ArgumentError(self, _EMPTY)
        parser.met.add(self.dest)
        setattr(namespace, self.dest, values)


class Parser(argparse.ArgumentParser):
    """Reports a mistake as one line, like everything else here.

    Attributes:
        met: the options of one value that the command line has had so far.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.met: set[str] = set()
        self.register("action", None, _Once)
        self.register("type", int, _whole)
        self.register("type", Path, _path)

    def parse_known_args(self, *arguments: Any, **named: Any) -> Any:
        """As argparse does."""
        self.met = set()
        return super().parse_known_args(*arguments, **named)

    def actions(self) -> Sequence[argparse.Action]:
        """All that can be given, commands below this one not looked into."""
        return self._actions

    def given(self, arguments: argparse.Namespace) -> dict[str, str]:
        """What the command line says beyond the defaults: attribute -> the flag, as one writes it.

        A command that leaves some of it unused has to refuse it: a user who gives a flag expects
        something of it.
        """
        return {
            action.dest: [f"the {action.dest}", *action.option_strings][-1]
            for action in self._actions
            if getattr(arguments, action.dest, action.default) != action.default
        }

    def alone(self, arguments: argparse.Namespace, asked: str, why: str, *beside: str) -> bool:
        """Whether a flag is given, with nothing beside it that would do nothing.

        Args:
            asked: the flag's attribute.
            why: what it does, for the line that refuses the others.
            beside: attributes of what may be given with it.

        Raises:
            UserError: something else is given.
        """
        given = self.given(arguments)
        if asked not in given:
            return False
        if idle := [flag for name, flag in given.items() if name not in (asked, *beside)]:
            raise UserError(f"{why}: leave out {idle[0]}")
        return True

    def error(self, message: str) -> NoReturn:
        prefix, _, given = message.partition("unrecognized arguments: ")
        if not prefix and given.startswith("-"):
            flags = [flag for flag in self._option_string_actions if flag.startswith("--")]
            raise unknown("flag", given.split()[0].partition("=")[0], flags)
        raise UserError(f"{message} (see --help)")
