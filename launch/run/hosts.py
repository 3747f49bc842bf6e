"""`--hosts FILE`: the command of each host of a run, printed, or run there by ssh.

env_host = "192.0.2.1"              # as ssh and the learners reach it
python = ".venv/bin/python"         # on every host, from `directory`

[learners]
agent_0 = "192.0.2.2"
agent_1 = "ana@192.0.2.3"
"""

import argparse
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field

from otc_dist.bus.addresses import HOST_FORM, in_brackets, is_host, is_ipv6
from otc_dist.bus.keys import HOST
from otc_dist.description import toml_file
from otc_dist.description.section import Section
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError, unknown
from otc_dist.terminal.printable import say

from ..supervise.signals import Signals
from ..supervise.supervisor import End, Supervisor

# -tt: what runs there ends when the link does; --: no option comes after it.
_SSH = ("ssh", "-tt", "-o", "BatchMode=yes", "--")
_PLAIN = ("env", "TERM=dumb")  # what runs there is given a terminal, and must write lines to it
INSECURE = (
    "WARNING: --insecure: nothing on the network is encrypted or checked; anyone who reaches the"
    " endpoint can read this run, act in it and end it"
)
_USER = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+@-]*")


def _machine(text: str) -> str:
    user, at, address = text.rpartition("@")
    if (at and not _USER.fullmatch(user)) or not is_host(address):
        raise ValueError(f"{text!r} is not {HOST_FORM}, with or without user@ before it")
    return text


Machine = Annotated[str, AfterValidator(_machine)]


class Hosts(Section):
    """What the file says. Machines are written as for ssh: address, or user@address."""

    env_host: Machine
    learners: dict[str, Machine]
    port: int = Field(default=7447, ge=1, le=65535)
    python: str = "python"
    directory: str = ""
    certs: str = "certs"

    @property
    def address(self) -> str:
        """Of the env host, without ssh's user."""
        return self.env_host.rpartition("@")[2]

    @property
    def anywhere(self) -> str:
        """All addresses of the env host's machine, to listen on."""
        return "[::]" if is_ipv6(self.address) else "0.0.0.0"

    @classmethod
    def load(cls, path: Path, team: TeamSpec) -> Self:
        """Read a file. Raises UserError for one that is none, or not of this team."""
        hosts = toml_file.load(cls, path)
        for agent in hosts.learners:
            if agent not in team.names:
                raise unknown("agent", agent, team.names)
        for agent in team.names:
            if agent not in hosts.learners:
                raise UserError(f"{path} names no host for {agent}: add it to [learners]")
        return hosts


@dataclass(frozen=True)
class Part:
    """What one launcher starts, on which machine, by which command line there."""

    name: str
    machine: str
    command: str


def parts(hosts: Hosts, run: Sequence[str], insecure: bool, router: bool) -> Iterator[Part]:
    """The env host, then the learners.

    Args:
        run: the words that say which run it is.
        router: whether the description names a router, at which all meet.
    """
    scheme = "tcp" if insecure else "tls"
    safety = ("--insecure",) if insecure else ("--certs", hosts.certs)
    listen = () if router else ("--listen", f"{scheme}/{hosts.anywhere}:{hosts.port}")
    connect = () if router else ("--connect", f"{scheme}/{in_brackets(hosts.address)}:{hosts.port}")
    yield _part(hosts, HOST, hosts.env_host, (*run, "--role", "host", *listen, *safety))
    for agent, machine in hosts.learners.items():
        learner = ("--role", "learner", "--agent", agent)
        yield _part(hosts, agent, machine, (*run, *learner, *connect, *safety))


def _part(hosts: Hosts, name: str, machine: str, arguments: Sequence[str]) -> Part:
    command = f"{hosts.python} -m otc_dist.launch {shlex.join(arguments)}"
    return Part(name, machine, f"cd {hosts.directory} && {command}" if hosts.directory else command)


def run_words(arguments: argparse.Namespace) -> list[str]:
    """The words of a command line that say which run it is."""
    words = [arguments.description]
    for value in arguments.set:
        words += ["--set", value]
    if arguments.seed is not None:
        words += ["--seed", str(arguments.seed)]
    return words + (["--quick"] if arguments.quick else [])


def show(hosts: Hosts, every: Sequence[Part], insecure: bool) -> None:
    """Print the commands, by host, and before them those that bring each its certificate."""
    if not insecure:
        agents = len(hosts.learners)
        made = f"python -m otc_dist.certs certs --agents {agents} --host {hosts.address}"
        print(f"once, here:\n  {made}")
        folder = "/".join(filter(None, (hosts.directory, hosts.certs)))
        for part in every:
            user, at, address = part.machine.rpartition("@")
            there = f"{user}{at}{in_brackets(address)}:{folder}/"
            print(f"  ssh {part.machine} mkdir -p {folder} && scp -r certs/{part.name} {there}")
    for part in every:
        print(f"on {part.machine}:\n  {part.command}")


def by_ssh(part: Part) -> Sequence[str]:
    """The command that runs a part's on its host, and ends with it."""
    return (*_SSH, part.machine, part.command)


def run(every: Sequence[Part], logs: Path, started: Callable[[Part], Sequence[str]]) -> int:
    """Run the commands on their hosts, and end all when one fails. Returns the exit status.

    What the env host's launcher prints is shown; what the learners' print goes to `logs`.

    Args:
        started: the command that starts a part where it belongs.
    """
    print(f"the learners' output is in {logs}", flush=True)
    with Signals() as signals, Supervisor(signals) as supervisor:
        for part in every:
            output = None if part.name == HOST else logs / f"{part.name}.log"
            seen = output is None and sys.stdout.isatty()
            command = started(part)
            supervisor.start(part.name, command if seen else (*_PLAIN, *command), output)
        while supervisor.running and not signals.stop:
            signals.wait(0.5)
            for end in supervisor.ended():
                if end.status != 0:
                    _explain(end, every)
                    return 1
        if signals.stop:
            print(f"stopped by {signals.stop.name}; the same command continues")
            return 128 + signals.stop
    return 0


def _explain(end: End, every: Sequence[Part]) -> None:
    machine = next(part.machine for part in every if part.name == end.process)
    print(
        f"error: {end.process} on {machine} {end.manner}; all others are stopped", file=sys.stderr
    )
    for line in end.last_lines(3):
        say(f"  {line}", file=sys.stderr)
