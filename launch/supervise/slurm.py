"""Jobs in SLURM's queue: each is submitted once, and begins when those that it needs are done.

Nothing is noted here. A job in the queue has its product's path as its comment, so the same command
finds it again, from any host of the cluster. What SLURM ended (a limit, a failure) has no product
and is not in the queue: the same command submits it again.
"""

import re
import shlex
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import printable

from .jobs import Job
from .supervisor import End

_ANSWER = 60.0  # seconds that a busy controller may take
# What ties a job to its product and to what it needs.
_OURS = (
    *("chdir", "comment", "dependency", "error", "job-name", "kill-on-invalid-dep", "output"),
    *("array", "parsable", "wait", "wrap"),
)


@dataclass(frozen=True)
class Queued:
    """A job that waits or runs."""

    id: str
    state: str  # "PENDING", "RUNNING", ...
    reason: str  # why it waits; "None" once it runs

    def __str__(self) -> str:
        reason = "" if self.reason in ("None", "") else f" ({self.reason})"
        return f"{self.state.lower()}{reason}, SLURM's job {self.id}"


def options(texts: Sequence[str]) -> tuple[str, ...]:
    """`key=value` as options of sbatch: partition=gpu, time=4:00:00, mem=4G, account=lab.

    Raises:
        UserError: it has another form, or sets what ties the jobs together.
    """
    found = []
    for text in texts:
        if not re.fullmatch(r"[a-z][a-z-]*=[^\n\0]+", text):
            raise UserError(f"--slurm {printable(text)}: write key=value, like time=4:00:00")
        if (key := text.partition("=")[0]) in _OURS:
            raise UserError(f"--slurm {key} is set for every job by what it needs and makes")
        found.append(f"--{text}")
    return tuple(found)


def queue() -> dict[Path, Queued]:
    """The user's jobs that wait or run, by their products. UserError if SLURM does not answer."""
    lines = _ask(["squeue", "--me", "--noheader", "--array", "--format=%i|%T|%r|%k"]).splitlines()
    found = {}
    for line in lines:
        number, state, reason, product = line.split("|", 3)
        found[Path(product)] = Queued(number, state, reason)
    return found


def nodes() -> list[str]:
    """The nodes of the allocation that this process is in. UserError if SLURM does not say."""
    return _ask(["scontrol", "show", "hostnames"]).split()


def submit(jobs: Sequence[Job], wanted: Sequence[str]) -> tuple[int, str]:
    """Submit the jobs that are neither done nor in the queue.

    Args:
        jobs: each after those that it needs.
        wanted: options of sbatch for every job, from `options`.

    Returns:
        how many were submitted, and what was refused after them; "": nothing was.

    Raises:
        UserError: there is no SLURM here, or it refuses a job when none of them is in the queue.
    """
    ids = {product: job.id for product, job in queue().items()}
    ours = sum(job.product in ids for job in jobs)
    count = 0
    for job in jobs:
        if job.done or job.product in ids:
            continue
        job.output.parent.mkdir(parents=True, exist_ok=True)
        after = [ids[need] for need in job.needs if need in ids]
        try:
            ids[job.product] = _ask(_sbatch(job, after, wanted)).strip().partition(";")[0]
        except UserError as error:
            refused = f"{job.name}: {error}"
            if count or ours:
                return count, refused
            raise UserError(refused) from None
        count += 1
    return count, ""


def status(jobs: Sequence[Job]) -> Iterator[tuple[str, str]]:
    """Where each job stands that is not done: its name, and a few words."""
    queued = queue()
    for job in jobs:
        if not job.done:
            yield job.name, _where(job, queued)


def _where(job: Job, queued: Mapping[Path, Queued]) -> str:
    if found := queued.get(job.product):
        return str(found)
    if lines := End(job.name, 1, job.output).last_lines():
        return f"ended without its product; its last line: {lines[-1]}"
    return "not in the queue"


def _sbatch(job: Job, after: Sequence[str], wanted: Sequence[str]) -> list[str]:
    needs = (f"--dependency=afterok:{':'.join(after)}", "--kill-on-invalid-dep=yes")
    return [
        *("sbatch", "--parsable", "--requeue", "--cpus-per-task=1", *wanted),
        *(f"--job-name={job.name}", f"--comment={job.product}"),
        f"--output={str(job.output).replace('%', '%%')}",
        *(needs if after else ()),
        f"--wrap={shlex.join(job.command)}",
    ]


def _ask(command: Sequence[str]) -> str:
    """What a command of SLURM's prints. UserError: there is none, or it refuses."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_ANSWER, check=False)
    except FileNotFoundError:
        raise UserError(f"there is no SLURM on this machine: {command[0]} is not found") from None
    except subprocess.TimeoutExpired:
        raise UserError(f"SLURM's {command[0]} gave no answer in {_ANSWER:.0f} s") from None
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        first = lines[0] if lines else f"exit status {done.returncode}"
        raise UserError(f"SLURM refuses: {printable(first)}")
    return done.stdout
