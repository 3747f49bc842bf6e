"""`--on slurm`: a run across the nodes of the SLURM allocation in which the launcher is started.

The env host is on the first node and the learners are shared out over the others, if there are any.
srun starts each part where it belongs, as ssh does for `--hosts FILE --ssh`.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from otc_dist.certs import authority
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError

from ..supervise import slurm
from .hosts import Hosts, Part

_PORTS = (20_000, 10_000)  # first, and how many: an allocation's own, so that two share a node
# Parts share the cores of a node as the kernel sees fit, as processes of one machine do.
_SRUN = ("srun", "--quiet", "--nodes=1", "--ntasks=1", "--overlap", "--cpu-bind=none")


def hosts(team: TeamSpec, certs: Path) -> Hosts:
    """Which part is on which node of this allocation.

    Raises:
        UserError: it is not one, or SLURM does not say which nodes it has.
    """
    job = os.environ.get("SLURM_JOB_ID", "")
    if not job.isdecimal():
        raise UserError(
            "--on slurm starts a run's parts on the nodes of an allocation, and this is none:"
            " begin with salloc --nodes=N, or put the same command into a script for sbatch"
        )
    first, *others = slurm.nodes()
    places = others or [first]
    return Hosts(
        env_host=first,
        learners={agent: places[n % len(places)] for n, agent in enumerate(team.names)},
        port=_PORTS[0] + int(job) % _PORTS[1],
        python=sys.executable,
        certs=str(certs),
    )


def make_certificates(found: Hosts) -> None:
    """One for every part, in a folder that only their user can read, on the shared file system."""
    for line in authority.make(Path(found.certs), [*found.learners], [found.address], days=365):
        print(line)


def started(part: Part) -> Sequence[str]:
    """The command that starts a part on its node, and ends with it."""
    return (*_SRUN, f"--nodelist={part.machine}", "sh", "-c", part.command)
