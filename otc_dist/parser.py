"""The argument parser of all commands."""

import argparse
from typing import NoReturn

from otc_dist.errors import UserError, unknown


class Parser(argparse.ArgumentParser):
    """Reports a mistake as one line, like everything else here."""

    def error(self, message: str) -> NoReturn:
        prefix, _, given = message.partition("unrecognized arguments: ")
        if not prefix and given.startswith("-"):
            flags = [flag for flag in self._option_string_actions if flag.startswith("--")]
            raise unknown("flag", given.split()[0].partition("=")[0], flags)
        raise UserError(f"{message} (see --help)")
