"""What both services share: the command line, the run they belong to, and how they end."""

import argparse
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import FrameType
from typing import Self

from otc_dist.bus.agreement import copies_by_phase, longest_message, run_spec
from otc_dist.bus.endpoints import Endpoint, local_endpoint, parse_endpoint
from otc_dist.bus.keys import Keys
from otc_dist.bus.lockstep import GaveUpError
from otc_dist.bus.replies import RunSpec
from otc_dist.datasets.inputs import Digests, check
from otc_dist.description import Description, user_code
from otc_dist.envs.registry import team_spec
from otc_dist.names import Name
from otc_dist.run.exploration import Schedule
from otc_dist.run.folder import RunFolder
from otc_dist.spec import TeamSpec
from otc_dist.system import records
from otc_dist.terminal import output
from otc_dist.terminal.errors import UserError, leave, os_error_line
from otc_dist.terminal.parser import Parser
from otc_dist.terminal.printable import printable, say

log = logging.getLogger(__name__)


_ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_STOPPED_BY_FILE = 3  # exit status, which the launcher knows


class FailureError(Exception):
    """The service cannot go on, and it is not the user's mistake. The message is one line."""


class StoppedByFileError(Exception):
    """A person's file asked the service to end. The message is one line."""


class _StoppedError(BaseException):
    """A signal asked the service to end."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@dataclass(frozen=True)
class _Record:
    """What of run.json, which the launcher writes, is needed."""

    run: Name
    inputs: Mapping[str, str] = field(default_factory=dict)
    processors: tuple[str, ...] = ()


@dataclass(frozen=True)
class Run:
    """A run that has been resolved: its folder, description, team and keys."""

    folder: RunFolder
    description: Description
    team: TeamSpec
    keys: Keys
    inputs: Digests  # with which it began; see there
    moved: bool  # whether it has come from another kind of processor

    @classmethod
    def open(cls, root: Path) -> Self:
        """Read a run folder.

        Raises:
            UserError: it is not a run folder, or its description is not resolved.
        """
        folder = RunFolder(root.resolve())
        description = Description.load(folder.description)
        user_code.allow(*description.code)  # what of it this process needs is loaded there
        try:
            record = records.read_json(_Record, folder.run_json)
        except FileNotFoundError:
            raise folder.lacks(folder.run_json) from None
        size, copies = description.deployment.transitions, description.env.copies
        if size < 1 or size % copies:
            raise UserError(
                f"{folder.description} is not resolved: deployment.transitions is {size},"
                f" no multiple of env.copies ({copies})"
            )
        keys, moved = Keys(record.run, description.shared_digest()), len(record.processors) > 1
        team = team_spec(description.env.id)
        return cls(folder, description, team, keys, record.inputs, moved)

    def check(self, found: Digests) -> None:
        """Raises UserError if an input is another one than when the run began."""
        check(self.inputs, found, self.description)

    @property
    def schedule(self) -> Schedule:
        """Who explores when in a deployment, and how many lock-steps it has."""
        return Schedule.of(self.description, len(self.team.agents))

    @property
    def copies(self) -> dict[str, int]:
        """E, by phase."""
        return copies_by_phase(self.description)

    @property
    def spec(self) -> RunSpec:
        """What env host and learners must agree on."""
        return run_spec(self.description, self.team)

    @property
    def maximum_payload(self) -> int:
        """The longest message, bytes."""
        return longest_message(self.description, self.team)

    @cached_property
    def local_bus(self) -> Endpoint:
        """Where the bus is on one machine; the same as long as this process lives."""
        return Endpoint(local_endpoint(self.folder.root))


def parser(module: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """A command line with what both services take."""
    made = Parser(
        prog=f"python -m otc_dist.services.{module}",
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument(
        "--run", type=Path, required=True, metavar="DIR", help="the run folder (the launcher's)"
    )
    made.add_argument(
        "--certs",
        type=Path,
        metavar="DIR",
        help="certificates, for tls/ (see otc_dist.certs)",
    )
    made.add_argument(
        "--insecure", action="store_true", help="permit endpoints that anyone can use"
    )
    made.add_argument(
        "--patience",
        type=float,
        metavar="SECONDS",
        help="how long the others may take to come (default: bus.answer_deadline)",
    )
    return made


def check_endpoints(arguments: argparse.Namespace) -> None:
    """Refuse flags of the command line that would do nothing.

    Raises:
        UserError: two endpoints, or how to meet others where nobody is met on a network.
    """
    listen: str | None = getattr(arguments, "listen", None)
    if listen and arguments.connect:
        raise UserError("--connect is instead of --listen: leave one of them out")
    if not (listen or arguments.connect) and (arguments.certs or arguments.insecure):
        flag = "--certs" if arguments.certs else "--insecure"
        raise UserError(f"{flag} is for an endpoint on a network, and none is given: leave it out")


def patience(run: Run, arguments: argparse.Namespace) -> float:
    """Seconds to wait until another process has come."""
    given: float | None = arguments.patience
    return run.description.bus.answer_deadline if given is None else given


def endpoint_at(locator: str, process: str, arguments: argparse.Namespace) -> Endpoint:
    """The endpoint of `process` that the command line names; UserError as `parse_endpoint`."""
    endpoint = parse_endpoint(locator, process, arguments.certs, arguments.insecure)
    if arguments.insecure:
        log.warning(
            "WARNING: --insecure: anyone who reaches %s can read this run, act in it and end it",
            locator,
        )
    return endpoint


def serve(body: Callable[[], None]) -> None:
    """Run a service to its end and exit: 0 done, 2 the user's mistake, 1 a failure, 128 + signal,
    3 stopped by a person's file.

    SIGTERM, SIGINT and SIGHUP, unless that is ignored (nohup), end it in order: what is open is
    closed, what was recorded stays.
    """
    output.steady()
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    for number in _ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop)
    try:
        body()
        status = 0
    except UserError as error:
        say(printable(f"error: {error}"), file=sys.stderr)
        status = 2
    except (FailureError, GaveUpError) as error:
        say(printable(f"error: {error}"), file=sys.stderr)
        status = 1
    except OSError as error:  # a full disk, a folder that went
        say(printable(f"error: {os_error_line(error)}"), file=sys.stderr)
        status = 1
    except StoppedByFileError as stopped:
        say(printable(f"stopped: {stopped}"), file=sys.stderr)
        status = _STOPPED_BY_FILE
    except _StoppedError as stopped:
        print(f"stopped by {signal.Signals(stopped.number).name}", file=sys.stderr)
        status = 128 + stopped.number
    leave(status)


def _stop(number: int, _: FrameType | None) -> None:
    for other in _ENDING:
        signal.signal(other, signal.SIG_IGN)  # closing is under way; it takes seconds at most
    raise _StoppedError(number)


@contextmanager
def orderly() -> Iterator[Callable[[], bool]]:
    """Meanwhile a signal does not end the service at once but when this is left; what is given
    says whether one has come.
    """
    noted: list[int] = []
    before = {number: signal.getsignal(number) for number in _ENDING}
    for number, handler in before.items():
        if handler is _stop:
            signal.signal(number, lambda number, _: noted.append(number))
    try:
        yield lambda: bool(noted)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if noted:
            _stop(noted[0], None)


@contextmanager
def recording(path: Path, kept: str) -> Iterator[None]:
    """Turn a full disk, or one that fails, into one line; `kept` says what is not lost."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise FailureError(
            f"cannot write {path}: {reason}; {kept}: fix it and resume the run"
        ) from None
