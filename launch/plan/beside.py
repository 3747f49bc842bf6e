"""What goes on beside a run and changes nothing in it: neither its description nor run.json know.

It is asked for at each start: trackers, metrics and views belong to whoever watches, not to the
run.
"""

import argparse
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from otc_dist.spec import TeamSpec
from otc_dist.system import extras
from otc_dist.system.ports import Port
from otc_dist.terminal.errors import UserError
from otc_dist.track.trackers import TRACKERS, check_installed
from otc_dist.view.__main__ import PORT

from .placement import Role


@dataclass(frozen=True)
class Companion:
    """A process beside the run.

    Attributes:
        again: what can be done without it, as the end of a sentence.
    """

    name: str
    command: tuple[str, ...]
    again: str


@dataclass(frozen=True)
class Beside:
    """What of it is asked for.

    Attributes:
        tracker: to which tracker the run is written as it goes on; empty: to none.
        prometheus: where the env host answers Prometheus, as `Port.parse` has it; empty: nowhere.
        view: where browsers are shown the newest deployment, likewise.
    """

    tracker: str = ""
    prometheus: str = ""
    view: str = ""

    @classmethod
    def of(cls, arguments: argparse.Namespace, role: Role) -> Self:
        """What the command line asks for.

        Args:
            role: which part of the run is started.

        Raises:
            UserError: a package is missing, or nobody can listen at the port.
        """
        beside = cls(arguments.track or "", arguments.prometheus or "", arguments.view or "")
        ports = [Port.parse(text) for text in (beside.view, beside.prometheus) if text]
        if len(ports) == 2 and ports[0].meets(ports[1]):
            raise UserError(f"--view and --prometheus both want port {ports[0].number}: give two")
        if beside.tracker:
            check_installed(beside.tracker)
        if beside.prometheus:
            if role == "learner":
                raise UserError("--prometheus is for where the env host is: a learner has none")
            extras.check("--prometheus", ["prometheus_client"], "prometheus")
            Port.parse(beside.prometheus).check_free()
        if beside.view:
            if role == "learner":
                raise UserError("--view is for where the env host is: a learner has no log")
            Port.parse(beside.view).check_free()
        return beside

    def check_team(self, team: TeamSpec) -> None:
        """Raises UserError if there is nothing to be seen of a team that is to be viewed."""
        if self.view:
            from otc_dist.view.newest import scene_of  # scenes, which are needed for nothing else

            scene_of(team)

    @property
    def address(self) -> str:
        """In words, where the run is to be seen; "" if nowhere."""
        return f"its deployments are shown at http://{Port.parse(self.view)}/" if self.view else ""

    def host_flags(self) -> tuple[str, ...]:
        """What the env host's command line says of it."""
        return ("--prometheus", self.prometheus) if self.prometheus else ()

    def companions(self, run: Path) -> Iterator[Companion]:
        """The processes beside the run in that folder."""
        module = (sys.executable, "-m")
        if self.tracker:
            command = (*module, "otc_dist.track", str(run), "--to", self.tracker)
            again = f"all is written by {shlex.join(command)}"
            yield Companion("tracking", (*command, "--follow"), again)
        if self.view:
            command = (*module, "otc_dist.view", str(run), "--at", self.view)
            yield Companion("view", command, f"it is viewed by {shlex.join(command)}")

    @staticmethod
    def add_flags(parser: argparse.ArgumentParser) -> None:
        """The flags that ask for it."""
        group = parser.add_argument_group("beside the run (see docs/running.md)")
        group.add_argument(
            "--track", choices=sorted(TRACKERS), help="write the run to this tracker as it goes on"
        )
        group.add_argument(
            "--prometheus",
            metavar="[HOST:]PORT",
            help="the env host answers Prometheus there, under /metrics (HOST: the loopback)",
        )
        group.add_argument(
            "--view",
            nargs="?",
            const=PORT,
            type=_port,
            metavar="[HOST:]PORT",
            help="show its newest deployment in a browser, there (default: %(const)s; HOST: the"
            " loopback)",
        )


def _port(text: str) -> str:
    """At once: a description that stands after `--view` would be taken for it."""
    Port.parse(text)
    return text


NOTHING = Beside()
