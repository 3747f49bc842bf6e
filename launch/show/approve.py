"""`launch approve RUN`: let the deployment, or the episode, that waits for a person begin."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from otc_dist.run.folder import RunFolder
from otc_dist.system import records
from otc_dist.terminal.amounts import plus_minus
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import say

from ..plan.run_record import RunRecord


@dataclass(frozen=True)
class _Measured:
    """What the deployment before measured."""

    deployment: int
    mean: float
    error: float
    episodes: int


@dataclass(frozen=True)
class Waiting:
    """The contents of waiting.json: for what the env host waits, as it says itself."""

    waits_for: str
    deployment: Annotated[int, Field(ge=1, lt=2**31)]
    policy: int
    approve_by: str
    step: Annotated[int, Field(ge=0, lt=2**32)] | None = None  # before which devices are reset
    measured: _Measured | None = None
    greedy_return: float | None = None


def command_line() -> Parser:
    """The parser of the command's arguments."""
    parser = Parser(
        prog="python -m otc_dist.launch approve",
        description="Let what a run waits for begin: a deployment (deployment.approve), or an"
        " episode for which the devices have been reset (deployment.reset_by_hand).",
        allow_abbrev=False,
    )
    parser.add_argument(
        "run", type=Path, metavar="RUN", help="the run's folder, on the machine of the env host"
    )
    return parser


def main(argv: list[str]) -> int:
    """Approve it. Returns the exit status.

    Raises:
        UserError: not a run's folder, nothing waits there, or it cannot be written.
    """
    folder = RunFolder(command_line().parse_args(argv).run.resolve())
    RunRecord.read(folder)  # a folder without a record is not a run's
    state = waiting(folder)
    if state is None:
        raise UserError(f"{folder.root} is not waiting for anyone now")
    resets = state.step is not None
    approval = folder.reset_approval if resets else folder.approval(state.deployment)
    try:
        approval.touch()
    except OSError as error:
        raise UserError(f"cannot write {approval}: {error.strerror}") from None
    what = f", from step {state.step} on" if resets else ""
    say(f"approved: deployment {state.deployment}{what}, by policy {state.policy}")
    return 0


def waiting(folder: RunFolder) -> Waiting | None:
    """For what the env host waits, as it says itself; None: for nobody.

    Raises:
        UserError: the file is damaged.
    """
    try:
        return records.read_json(Waiting, folder.waiting)
    except FileNotFoundError:
        return None


def waiting_lines(folder: RunFolder) -> list[str]:
    """For what it waits, with what is known of the policies, and how to let it begin."""
    state = waiting(folder)
    if state is None:
        return []
    line, measured = f"waits for {state.waits_for}", state.measured
    if measured:
        found = plus_minus(measured.mean, measured.error)
        line += f"; deployment {measured.deployment} measured {found}"
    if state.greedy_return is not None:
        line += f"; its greedy return is {state.greedy_return:,.1f}"
    return [line, f"approve with: python -m otc_dist.launch approve {folder.root}"]
