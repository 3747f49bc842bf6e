"""A run whose parts are started elsewhere: on the hosts of a file, by SLURM, or by Kubernetes."""

import argparse
import sys
from pathlib import Path

from otc_dist.description import Description
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError

from . import allocation, hosts, kubernetes


def start(arguments: argparse.Namespace, chosen: Description, team: TeamSpec) -> int:
    """Start the parts, or show what starts them. Returns the exit status.

    Raises:
        UserError: as the ways to do so; what nobody can do for the user.
    """
    if arguments.insecure:
        print(hosts.INSECURE, file=sys.stderr)
    kubernetes_only = arguments.print or arguments.image != kubernetes.IMAGE
    if arguments.on == "slurm" and kubernetes_only:
        raise UserError("--print and --image are for --on kubernetes: leave them out")
    if arguments.on == "kubernetes":
        if not arguments.print:
            raise UserError(
                "nothing is applied from here: add --print, and give it to kubectl apply -f -"
            )
        print(kubernetes.text(arguments, chosen, team))
        return 0
    if arguments.on == "slurm":
        return _on_allocation(arguments, chosen, team)
    return _on_hosts(arguments, team, bool(chosen.bus.router))


def _on_hosts(arguments: argparse.Namespace, team: TeamSpec, router: bool) -> int:
    file = hosts.Hosts.load(arguments.hosts, team)
    every = list(hosts.parts(file, hosts.run_words(arguments), arguments.insecure, router))
    if not arguments.ssh:
        hosts.show(file, every, arguments.insecure)
        return 0
    return hosts.run(every, Path("runs") / f"{arguments.hosts.stem}-output", hosts.by_ssh)


def _on_allocation(arguments: argparse.Namespace, chosen: Description, team: TeamSpec) -> int:
    named = f"{chosen.name}{'-quick' if arguments.quick else ''}-seed{chosen.seed}"
    found = allocation.hosts(team, Path("runs") / f"{named}-certs")
    if not arguments.insecure:
        allocation.make_certificates(found)
    words, router = hosts.run_words(arguments), bool(chosen.bus.router)
    every = list(hosts.parts(found, words, arguments.insecure, router))
    return hosts.run(every, Path("runs") / f"{named}-output", allocation.started)
