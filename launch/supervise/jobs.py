"""Many jobs on all cores: each a process, started when what it needs is done."""

import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from otc_dist.terminal.amounts import duration

from . import job_order
from .health import LIMIT
from .signals import Signals
from .standstill import Standstill
from .supervisor import End, Supervisor

LOOK_EVERY = 0.5  # seconds between two looks at the processes
LINE_EVERY = 30.0  # seconds between two progress lines
LINE_OF_JOB_EVERY = 1.0  # seconds between two lines of a job


@dataclass(frozen=True)
class Job:
    """One process, done when the file `product` exists."""

    name: str  # for people: "seed 3, arm uniform"
    command: tuple[str, ...]
    product: Path
    output: Path
    needs: tuple[Path, ...] = ()  # products of other jobs
    seconds: float = 1.0  # expected, of one core
    shared: float = 0.0  # of these, what several that are done together take once for all

    @property
    def done(self) -> bool:
        return self.product.exists()


class FailedError(Exception):
    """A job's process ended without success, or without its product."""

    def __init__(self, job: Job, end: End) -> None:
        lines = end.last_lines()
        last = lines[-1].removeprefix("error: ") if lines else "it printed nothing"
        if end.status == 2:  # a mistake, and the line says which
            super().__init__(f"{job.name}: {last}")
        else:
            super().__init__(f"{job.name}: {end.manner}: {last} ({end.output})")
        self.status = 2 if end.status == 2 else 1


@dataclass
class _RunningJob:
    """A job at work."""

    job: Job
    watched: Standstill
    started: float  # clock
    why: str = ""  # it was killed


class StoppedError(Exception):
    """The user, or the system, asked us to stop."""

    def __init__(self, status: int, name: str) -> None:
        super().__init__(name)
        self.status = status


def run_jobs(
    jobs: Sequence[Job], workers: int, finished: Callable[[Job], None], patience: float
) -> None:
    """Do all jobs that are not done, at most `workers` at once, in an order of `job_order`.

    One that is killed, or stands still, is begun again, while the others go on.

    Args:
        patience: seconds that a job may stand still.

    Raises:
        FailedError: a job failed by itself, or was killed too often; the others were stopped.
        StoppedError: a signal came; all were stopped.
    """
    waiting = [job for job in jobs if not job.done]
    running: dict[str, _RunningJob] = {}
    restarts = Counter[str]()
    clock = _Clock(sum(job.seconds for job in waiting), workers)
    chains = job_order.chains(waiting)
    with Signals() as signals, Supervisor(signals) as supervisor:
        while waiting or running:
            ready = [job for job in waiting if all(path.exists() for path in job.needs)]
            while ready and len(running) < workers:
                left = sum(job.seconds for job in waiting) + sum(
                    going.job.seconds for going in running.values()
                )
                job = job_order.next_job(ready, chains, left, workers)
                ready.remove(job)
                waiting.remove(job)
                job.output.unlink(missing_ok=True)
                supervisor.start(job.name, job.command, job.output)
                watched = Standstill(supervisor.pid(job.name), patience)
                running[job.name] = _RunningJob(job, watched, time.monotonic())
            signals.wait(LOOK_EVERY)
            if signals.stop:
                raise StoppedError(128 + signals.stop, signals.stop.name)
            for end in supervisor.ended():
                running_job = running.pop(end.process)
                job = running_job.job
                if end.status < 0 and restarts[job.name] < LIMIT:
                    restarts[job.name] += 1
                    how = end.manner + (f", since it {running_job.why}" if running_job.why else "")
                    again = f"starts again ({restarts[job.name]} of {LIMIT})"
                    print(f"{job.name}: {how}; {again}", flush=True)
                    waiting.insert(0, job)
                    continue
                if end.status != 0 or not job.done:
                    raise FailedError(job, end)
                clock.add(job.seconds)
                took = duration(time.monotonic() - running_job.started)
                print(f"{job.name}: done in {took}", flush=True)
                finished(job)
            for name, running_job in running.items():
                if not running_job.why and (why := running_job.watched.look(time.monotonic())):
                    running_job.why = why
                    supervisor.kill(name)
            clock.show(running_job.job for running_job in running.values())


class ProgressLines:
    """What a job prints: `0.25 where it stands`, now and then, for `run_jobs` to read."""

    def __init__(self) -> None:
        self._last = 0.0

    def __call__(self, share: float, where: str) -> None:
        now = time.monotonic()
        if now - self._last >= LINE_OF_JOB_EVERY:
            self._last = now
            print(f"{share:.4f} {where}", flush=True)


def _progress(job: Job) -> tuple[float, str]:
    """The newest progress line of a job: share done, and where it stands."""
    try:
        with job.output.open("rb") as file:
            file.seek(max(0, job.output.stat().st_size - 1000))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return 0.0, "starting"
    for line in reversed(lines):
        share, _, where = line.partition(" ")
        try:
            return float(share), where
        except ValueError:
            continue  # a warning, a library's line
    return 0.0, "starting"


class _Clock:
    """Progress lines with the time to go, by forecasts and by how true they have been."""

    def __init__(self, total: float, workers: int) -> None:
        self._total, self._workers = total, workers
        self._done = 0.0
        self._start = self._shown = time.monotonic()

    def add(self, seconds: float) -> None:
        self._done += seconds

    def show(self, running: Iterable[Job]) -> None:
        now = time.monotonic()
        if now - self._shown < LINE_EVERY:
            return
        self._shown = now
        newest = [(job, *_progress(job)) for job in running]
        done = self._done + sum(job.seconds * share for job, share, _ in newest)
        # Trust the forecasts until some seconds have shown how this machine compares with them.
        slower = ((now - self._start) * self._workers + 60) / (done + 60)
        left = duration((self._total - done) * slower / self._workers)
        lines = [f"{job.name}: {where}" for job, _, where in newest]
        print(f"{' · '.join(lines)} · about {left} to go", flush=True)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
