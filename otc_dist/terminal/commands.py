"""All commands, by the names that `otc-dist` knows them by."""

from dataclasses import dataclass

_LAUNCH = "otc_dist.launch.__main__"


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        help: what it does, in a line.
        module: whose `main(argv)` it is; imported only when it is asked for.
        word: the first of `argv`, before the command's own; empty: none.
        parser: the module whose `command_line()` is the parser of its own arguments.
    """

    help: str
    module: str
    word: str = ""
    parser: str = ""

    @classmethod
    def launch(cls, help: str, module: str, word: str = "") -> "Command":
        """One of the launcher's."""
        return cls(help, _LAUNCH, word, f"otc_dist.launch.{module}")


COMMANDS = {
    "launch": Command.launch(
        "run a description: data, offline training, deployments, report", "run.command"
    ),
    "compare": Command.launch(
        "tune several arms from the same offline policies, and compare them",
        "compare.command",
        "compare",
    ),
    "campaign": Command.launch(
        "do many comparisons that one file lists, seed by seed", "compare.campaign", "campaign"
    ),
    "mechanism": Command.launch(
        "measure what the transitions that a distance selects have in common",
        "compare.mechanism",
        "mechanism",
    ),
    "status": Command.launch(
        "where a run stands, and how its processes are", "show.status", "status"
    ),
    "approve": Command.launch(
        "let the deployment that waits for a person begin", "show.approve", "approve"
    ),
    "chaos": Command.launch(
        "kill, freeze and cut off a run's processes, and compare how it ends",
        "chaos.command",
        "chaos",
    ),
    "replay": Command(
        "look at deployment logs: verify, export, publish, recover, show them",
        "otc_dist.replay.__main__",
    ),
    "report": Command(
        "write the report of a run or of a comparison again", "otc_dist.report.__main__"
    ),
    "view": Command(
        "show a run's newest deployment in a browser, as it goes on", "otc_dist.view.__main__"
    ),
    "track": Command("write a run to a tracker: TensorBoard, MLflow", "otc_dist.track.__main__"),
    "datasets": Command("list, make, show and import offline data", "otc_dist.datasets.__main__"),
    "certs": Command("make certificates for a run on several hosts", "otc_dist.certs.__main__"),
}
# The launcher's, but the one that it does without a word.
OF_LAUNCH = {name: command for name, command in COMMANDS.items() if command.word}


def lines(commands: dict[str, Command]) -> list[str]:
    """A line for each: its name and what it does."""
    width = max(map(len, commands))
    return [f"  {name:{width}}  {command.help}" for name, command in commands.items()]
