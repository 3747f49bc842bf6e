"""`python -m otc_dist.launch`: the first word may name a command; without one, it is `run`."""

import importlib

from otc_dist.errors import run_main, unknown

# Command -> the module beside this one whose `main(argv)` it is; imported only when asked for.
COMMANDS = {
    "run": ".run_command",
    "compare": ".compare",
    "mechanism": ".mechanism",
    "status": ".status",
    "approve": ".approve",
    "chaos": ".chaos",
}


def main(argv: list[str]) -> int:
    """Run a command; returns the exit status. Raises UserError for the user's mistakes."""
    command = argv[0] if argv and argv[0] in COMMANDS else "run"
    words = argv[:2]
    if len(words) == 2 and words[0] not in COMMANDS and not any(w.startswith("-") for w in words):
        raise unknown("command", argv[0], COMMANDS)  # a description stands alone
    arguments = argv[1:] if argv and argv[0] == command else argv
    status: int = importlib.import_module(COMMANDS[command], __package__).main(arguments)
    return status


if __name__ == "__main__":
    run_main(main)
