"""The argument parser of all commands."""

import argparse
from collections.abc import Sequence
from typing import NoReturn

from otc_dist.terminal.errors import UserError, unknown


class Parser(argparse.ArgumentParser):
    """Reports a mistake as one line, like everything else here."""

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

    def error(self, message: str) -> NoReturn:
        prefix, _, given = message.partition("unrecognized arguments: ")
        if not prefix and given.startswith("-"):
            flags = [flag for flag in self._option_string_actions if flag.startswith("--")]
            raise unknown("flag", given.split()[0].partition("=")[0], flags)
        raise UserError(f"{message} (see --help)")
