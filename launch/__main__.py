"""`python -m otc_dist.launch`: the first word may name a command; without one, a run is begun."""

import importlib

from otc_dist.terminal.commands import COMMANDS, OF_LAUNCH
from otc_dist.terminal.errors import run_main, unknown

RUN = "run"  # the word for what is done without one


def main(argv: list[str]) -> int:
    """Run a command; returns the exit status. Raises UserError for the user's mistakes."""
    words = (*OF_LAUNCH, RUN)
    named = bool(argv) and argv[0] in words
    if len(argv) > 1 and not named and not any(word.startswith("-") for word in argv[:2]):
        raise unknown("command", argv[0], words)  # a description stands alone
    command = OF_LAUNCH.get(argv[0], COMMANDS["launch"]) if named else COMMANDS["launch"]
    status: int = importlib.import_module(command.parser).main(argv[1:] if named else argv)
    return status


if __name__ == "__main__":
    run_main(main)
