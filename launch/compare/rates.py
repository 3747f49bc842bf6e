"""How long jobs take here, by what jobs of their kind that are done have taken."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from otc_dist.comparison import spent
from otc_dist.comparison.scores import ComparisonFolder
from otc_dist.comparison.spent import Spent
from otc_dist.system.processor import processor

from ..supervise.jobs import Job
from .comparison import Comparison

Kind = tuple[str, ...]


def read(jobs: Iterable[Job]) -> dict[Path, Spent]:
    """Product -> what the job took, of those that are done and have said it.

    Raises:
        UserError: what a job says is damaged.
    """
    done = (job for job in jobs if job.done)
    return {job.product: found for job in done if (found := spent.read(spent.beside(job.output)))}


def measured(
    comparisons: Sequence[Comparison], jobs: Sequence[Job], took: Mapping[Path, Spent]
) -> list[Job]:
    """The same jobs, each as long as its forecast times what it was wrong by for those of its kind.

    Of its kind are those that do the same for another seed; where none of them has said what it
    took, for the same algorithm; for any algorithm; or all. Jobs of this kind of processor count,
    or where there is none of those, any. Without any, forecasts stay as they are.

    Args:
        took: what `read` has found.
    """
    kinds = {job.product: tuple(_kinds(comparisons, job)) for job in jobs}
    here = {made: found for made, found in took.items() if found.processor == processor()} or took
    took_by, expected = defaultdict[Kind, float](float), defaultdict[Kind, float](float)
    for job in jobs:
        if found := here.get(job.product):
            for kind in kinds[job.product]:
                took_by[kind] += found.processor_seconds
                # Each of several seeds that were trained together is listed as if it were alone.
                expected[kind] += job.seconds - job.shared * (1 - 1 / found.seeds)

    def times(job: Job) -> float:
        known = (kind for kind in kinds[job.product] if kind in took_by)
        return next((took_by[kind] / expected[kind] for kind in known), 1.0)

    return [replace(job, seconds=job.seconds * times(job)) for job in jobs]


def hours(jobs: Iterable[Job], took: Mapping[Path, Spent]) -> float:
    """What these jobs have said they took, in hours of one core."""
    return sum(took[job.product].processor_seconds for job in jobs if job.product in took) / 3600


def _kinds(comparisons: Sequence[Comparison], job: Job) -> Iterable[Kind]:
    """From the narrowest on."""
    piece = ComparisonFolder.job(job.output)
    piece = "offline" if piece.startswith("offline_") else piece  # of whichever agent
    for one in comparisons:
        if job.output.is_relative_to(one.folder.root):
            yield one.name, piece
            yield one.base.algorithm.name, piece
    yield (piece,)
    yield ()
