"""Jobs in SLURM's queue: each is submitted once, and begins when those that it needs are done.

Nothing is noted here. A job in the queue has its product's path as its comment, so the same command
finds it again, from any host of the cluster. What SLURM ended (a limit, a failure) has no product
and is not in the queue: the same command submits it again.
"""

import re
import shlex
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from otc_dist.terminal.errors import UserError
from otc_dist.terminal.printable import printable

from .jobs import Job
from .supervisor import SETTINGS, End

_ANSWER = 60.0  # seconds that a busy controller may take
# What ties a job to its product and to what it needs. SLURM takes the first letters of each, too.
_OURS = (
    *("chdir", "comment", "dependency", "error", "job-name", "kill-on-invalid-dep", "output"),
    *("array", "clusters", "parsable", "wait", "wrap"),
)
# A job's number, state, reason and comment. Comments of other jobs may hold line breaks.
_LINE = re.compile(r"([^|]+)\|([A-Z_]+)\|([^|]*)\|(.*)")
_HOPELESS = "DependencyNeverSatisfied"  # why a job waits whose end SLURM has not noted yet


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
        UserError: it has another form, is given twice, or sets what ties the jobs together.
    """
    found = dict[str, str]()
    for text in texts:
        if not re.fullmatch(r"[a-z][a-z-]*=[^\n\0]+", text):
            raise UserError(f"--slurm {printable(text)}: write key=value, like time=4:00:00")
        key = text.partition("=")[0]
        if any(name.startswith(key) for name in _OURS):
            raise UserError(f"--slurm {key} would part the jobs from what they need and make")
        if key in found:
            raise UserError(f"--slurm {key} is given twice, and takes one value")
        found[key] = f"--{text}"
    return tuple(found.values())


def queue(patience: float = _ANSWER) -> dict[Path, Queued]:
    """The user's jobs that wait or run, by their products.

    Args:
        patience: seconds that SLURM may take.

    Raises:
        UserError: there is no SLURM here, or it does not answer.
    """
    command = ("squeue", "--me", "--noheader", "--array", "--format=%i|%T|%r|%k")
    found = {}
    for line in filter(None, map(_LINE.fullmatch, _ask(command, patience).split("\n"))):
        number, state, reason, product = line.groups()
        if reason != _HOPELESS:
            found[Path(product)] = Queued(number, state, reason)
    return found


def nodes() -> list[str]:
    """The nodes of the allocation that this process is in. UserError if SLURM does not say."""
    if not (found := _ask(["scontrol", "show", "hostnames"]).split()):
        raise UserError("SLURM does not say which nodes this allocation has (SLURM_JOB_NODELIST)")
    return found


@dataclass
class Submission:
    """What became of jobs that were to be submitted.

    Attributes:
        new: how many were.
        before: how many were in the queue already.
        ended: of the new ones that ran before, in words, how they ended.
        refused: which was not taken, and why; "": all were.
    """

    new: int = 0
    before: int = 0
    ended: list[str] = field(default_factory=list)
    refused: str = ""


def submit(jobs: Sequence[Job], wanted: Sequence[str]) -> Submission:
    """Submit the jobs that are neither done nor in the queue.

    Args:
        jobs: each after those that it needs.
        wanted: options of sbatch for every job, from `options`.

    Raises:
        UserError: there is no SLURM here, it refuses a job when none of them is in the queue, or
            it cannot work with the name of their folder.
    """
    for path in (path for job in jobs for path in (job.product, job.output)):
        if "\\" in str(path) or not str(path).isprintable():
            raise UserError(f"SLURM cannot take {path} as a job's: its name has a control or a \\")
    ids = {product: job.id for product, job in queue().items()}
    made = Submission(before=sum(job.product in ids and not job.done for job in jobs))
    for job in jobs:
        if job.done or job.product in ids:
            continue
        ended = _ended(job)
        job.output.parent.mkdir(parents=True, exist_ok=True)
        after = [ids[need] for need in job.needs if need in ids]
        try:
            ids[job.product] = _ask(_sbatch(job, after, wanted)).strip().partition(";")[0]
        except UserError as error:
            made.refused = f"{job.name}: {error}"
            if made.new or made.before:
                return made
            raise UserError(made.refused) from None
        made.new += 1
        made.ended += [f"{job.name} {ended}"] if ended else []
    return made


def status(jobs: Sequence[Job]) -> Iterator[tuple[str, str]]:
    """Where each job stands that is not done: its name, and a few words."""
    queued = queue()
    for job in jobs:
        if not job.done:
            yield job.name, _where(job, queued)


def _where(job: Job, queued: Mapping[Path, Queued]) -> str:
    if found := queued.get(job.product):
        return str(found)
    return _ended(job) or "not in the queue"


def _ended(job: Job) -> str:
    """How a job ended that is neither done nor in the queue; "": it never ran."""
    if not job.output.exists():
        return ""
    last = [line for line in End(job.name, 1, job.output).last_lines() if line.strip()][-1:]
    return (
        f"ended without its product; {f'its last line: {last[0]}' if last else 'it said nothing'}"
    )


def _sbatch(job: Job, after: Sequence[str], wanted: Sequence[str]) -> list[str]:
    settings = (f"{name}={value}" for name, value in SETTINGS.items())
    needs = (f"--dependency=afterok:{':'.join(after)}", "--kill-on-invalid-dep=yes")
    return [
        *("sbatch", "--parsable", "--requeue", "--cpus-per-task=1", *wanted),
        *(f"--job-name={job.name}", f"--comment={job.product}"),
        f"--output={str(job.output).replace('%', '%%')}",
        *(needs if after else ()),
        f"--wrap={shlex.join(('exec', 'env', *settings, *job.command))}",
    ]


def _ask(command: Sequence[str], patience: float = _ANSWER) -> str:
    """What a command of SLURM's prints. UserError: there is none, or it refuses."""
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            encoding="utf-8",
            errors="surrogateescape",
            timeout=patience,
            check=False,
        )
    except FileNotFoundError:
        raise UserError(f"there is no SLURM on this machine: {command[0]} is not found") from None
    except subprocess.TimeoutExpired:
        raise UserError(f"SLURM's {command[0]} gave no answer in {patience:g} s") from None
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        # A cluster may greet before it says what is wrong.
        wrong = [line for line in lines if "error:" in line]
        first = (wrong or lines or [f"exit status {done.returncode}"])[0]
        raise UserError(f"SLURM refuses: {printable(first)}")
    return done.stdout
