"""What goes on beside a run and changes nothing in it: neither its description nor run.json know.

It is asked for at each start: trackers and metrics belong to whoever watches, not to the run.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from otc_dist.system import extras
from otc_dist.system.ports import Port
from otc_dist.terminal.errors import UserError
from otc_dist.track.trackers import TRACKERS, check_installed

from .placement import Role


@dataclass(frozen=True)
class Beside:
    """What of it is asked for.

    Attributes:
        tracker: to which tracker the run is written as it goes on; empty: to none.
        prometheus: where the env host answers Prometheus, as `Port.parse` has it; empty: nowhere.
    """

    tracker: str = ""
    prometheus: str = ""

    @classmethod
    def of(cls, arguments: argparse.Namespace, role: Role) -> Self:
        """What the command line asks for.

        Args:
            role: which part of the run is started.

        Raises:
            UserError: a package is missing, or nobody can listen at the port.
        """
        beside = cls(arguments.track or "", arguments.prometheus or "")
        if beside.tracker:
            check_installed(beside.tracker)
        if beside.prometheus:
            if role == "learner":
                raise UserError("--prometheus is for where the env host is: a learner has none")
            extras.check("--prometheus", ["prometheus_client"], "prometheus")
            Port.parse(beside.prometheus).check_free()
        return beside

    def host_flags(self) -> tuple[str, ...]:
        """What the env host's command line says of it."""
        return ("--prometheus", self.prometheus) if self.prometheus else ()

    def tracking(self, run: Path) -> tuple[str, ...]:
        """The command that writes the run in that folder to the tracker."""
        module = (sys.executable, "-m", "otc_dist.track")
        return (*module, str(run), "--to", self.tracker, "--follow")

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


NOTHING = Beside()
