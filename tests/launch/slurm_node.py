"""A SLURM cluster of one node on this machine, with its own controller, node and keys."""

import os
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scancel")
# The node says so much, but has it not: as many jobs run at once, and none is refused for memory.
_CONFIGURATION = """
ClusterName=tests
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
SlurmUser=root
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SchedulerParameters=sched_interval=1,batch_sched_delay=0,sched_min_interval=0
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


@contextmanager
def cluster(folder: Path) -> Iterator[dict[str, str]]:
    """The environment in which SLURM's commands find it; skips where that is not installed."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        pytest.skip("needs root and a SLURM: apt-get install slurm-wlm munge")
    for name in ("state", "spool"):
        (folder / name).mkdir()
    folder.chmod(0o755)
    host, configuration = socket.gethostname().partition(".")[0], folder / "slurm.conf"
    configuration.write_text(
        _CONFIGURATION.format(
            folder=folder, host=host, ports=(_port(), _port()), cores=os.cpu_count()
        )
    )
    key = folder / "munge.key"
    key.touch(0o600)
    key.write_bytes(os.urandom(1024))
    environment = {**os.environ, "SLURM_CONF": str(configuration)}
    files = [f"--{name}={folder}/munge.{name}" for name in ("pid-file", "log-file", "seed-file")]
    munged = ["munged", "--force", f"--key-file={key}", f"--socket={folder}/munge.socket", *files]
    try:
        for command in (
            munged,
            ["slurmctld"],
            ["slurmd"],
        ):
            subprocess.run(command, env=environment, check=True, capture_output=True)
        # Answers when the node has registered, and at once if it has.
        subprocess.run(
            ["srun", "--immediate=60", "true"], env=environment, check=True, capture_output=True
        )
        yield environment
    finally:
        for file in ("slurmd.pid", "slurmctld.pid", "munge.pid-file"):
            with suppress(FileNotFoundError, ProcessLookupError, ValueError):
                os.kill(int((folder / file).read_text()), signal.SIGTERM)


def _port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
