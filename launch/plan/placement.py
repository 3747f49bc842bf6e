"""Which part of a run is on this machine, and where it meets the rest."""

import argparse
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

from otc_dist.bus.diagnosis import absence, refusal
from otc_dist.bus.endpoints import (
    Endpoint,
    local_endpoint,
    local_socket,
    parse_endpoint,
    remove_local_endpoint,
)
from otc_dist.bus.keys import HOST, OBSERVER
from otc_dist.description import Description
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError, unknown

_PATIENCE = 24 * 3600  # seconds: other hosts may be started by hand, and make their data first
Role = Literal["all", "host", "learner"]


@dataclass(frozen=True)
class Placement:
    """What one launcher starts, and by which endpoint; kept in run.json.

    Attributes:
        role: "all" processes, the env "host", or the "learner" of `agent`.
        listen: endpoint of the env host for learners elsewhere; empty: none.
        connect: endpoint that this launcher's processes connect to: of the env host, or of a
            router; empty: the private socket of this machine.
        certs: folder of certificates; empty: none.
        router: whether `connect` is the description's router.
    """

    role: Role = "all"
    agent: str = ""
    listen: str = ""
    connect: str = ""
    certs: str = ""
    insecure: bool = False
    router: bool = False

    @classmethod
    def of(cls, arguments: argparse.Namespace, description: Description, team: TeamSpec) -> Self:
        """What the command line asks for.

        Raises:
            UserError: see `_check`; or a flag that does not fit the role.
        """
        role: Role = arguments.role or "all"
        if arguments.connect and role != "learner":
            raise UserError(
                "--connect is for --role learner; a router at which all processes meet is"
                " described as bus.router"
            )
        router = description.bus.router
        placement = cls(
            role=role,
            agent=arguments.agent or "",
            listen=arguments.listen or "",
            connect=arguments.connect or router,
            certs=str(arguments.certs.absolute()) if arguments.certs else "",
            insecure=arguments.insecure,
            router=bool(router) and not arguments.connect,
        )
        placement._check(team)
        return placement

    def _check(self, team: TeamSpec) -> None:
        """Refuse what cannot work, before anything is written.

        Raises:
            UserError: a flag that is missing, or does not fit the role; a bad endpoint or
                certificate.
        """
        if self.role == "learner":
            if not self.agent:
                raise UserError("--role learner needs --agent: whose learner? for example agent_0")
            if self.listen:
                raise UserError("--listen is for --role host; a learner needs --connect")
            if not self.connect:
                raise UserError(
                    "--role learner needs --connect ENDPOINT, the env host's: for example"
                    " tls/192.0.2.1:7447"
                )
        elif self.agent:
            raise UserError("--agent is for --role learner")
        if self.agent and self.agent not in team.names:
            raise unknown("agent", self.agent, team.names)
        if self.role == "host" and not self.listen and not self.connect:
            raise UserError(
                "--role host needs --listen ENDPOINT, for example tls/0.0.0.0:7447, or a router"
            )
        if self.role == "all" and self.listen:
            raise UserError("--listen is for --role host: without a role all is on this machine")
        if self.listen and self.connect:
            raise UserError("a host that listens needs no router: leave out --listen or bus.router")
        if not self.listen and not self.connect and (self.certs or self.insecure):
            flag = "--certs" if self.certs else "--insecure"
            raise UserError(f"{flag} is for runs on several hosts: on one, nobody else gets in")
        for endpoint in filter(None, (self.listen, self.connect)):
            for process in self.processes(team):
                parse_endpoint(endpoint, process, self._folder, self.insecure)
        if self.role != "learner" and self.connect:
            self.observed_at(Path())

    def processes(self, team: TeamSpec) -> tuple[str, ...]:
        """Names of the processes that are started here."""
        names = {"all": (HOST, *team.names), "host": (HOST,), "learner": (self.agent,)}
        return names[self.role]

    def flags(self, host: bool) -> Iterator[str]:
        """What the command line of a process says of where it meets the others.

        A learner waits for its env host in any case, which is looked after by a launcher.
        """
        if self.connect:
            yield from ("--connect", self.connect)
        elif self.listen:
            yield from ("--listen", self.listen)
        if self.role != "all" or not host:
            yield from ("--patience", str(_PATIENCE))
        if self.certs:
            yield from ("--certs", self.certs)
        if self.insecure:
            yield "--insecure"

    @property
    def meeting(self) -> str:
        """In words, where the processes of this machine meet those of others; "" if nowhere."""
        if self.listen:
            return f"the learners of other hosts are awaited at {self.listen}"
        if self.connect and self.role != "all":
            return f"the other hosts are met at {self.connect}"
        return f"all processes meet at {self.connect}" if self.connect else ""

    def check_access(self) -> None:
        """Find out where the others are met whether they let us in, before any work is done.

        Raises:
            UserError: we refuse them, or they us. That nobody is there yet is no mistake.
        """
        if self.connect and (reason := refusal(self.observed_at(Path()))):
            raise UserError(reason)

    @property
    def missing(self) -> str:
        """In words, for whom the processes of this machine wait now; "" if somebody is there."""
        return (absence(self.observed_at(Path())) if self.connect else None) or ""

    def observed_at(self, run: Path) -> Endpoint:
        """Where the launcher itself looks on: as the learner that it starts, or as an observer."""
        if not self.connect:
            return Endpoint(local_endpoint(run))
        return parse_endpoint(self.connect, self.agent or OBSERVER, self._folder, self.insecure)

    def local_socket(self, run: Path) -> Path | None:
        """The socket at which the env host listens for this machine; None: it does not.

        Raises:
            UserError: there is no place for one.
        """
        return None if self.connect else local_socket(local_endpoint(run))

    def leave(self, run: Path) -> None:
        """Remove what is left of the bus of this machine, once all its processes have ended."""
        if not self.connect:
            with suppress(UserError):
                remove_local_endpoint(local_endpoint(run))

    @property
    def host_is_router(self) -> bool:
        """Whether the env host's session carries the bus."""
        return not self.router

    @property
    def _folder(self) -> Path | None:
        return Path(self.certs) if self.certs else None
