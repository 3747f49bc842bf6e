"""How long jobs take here, by what jobs of their kind that are done have taken."""

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace

from otc_dist.comparison import spent
from otc_dist.system.processor import processor

from ..supervise.jobs import Job
from .comparison import Comparison

Kind = tuple[str, ...]


def measured(comparisons: Sequence[Comparison], jobs: Sequence[Job]) -> list[Job]:
    """The same jobs, each as long as its forecast times what it was wrong by for those of its kind.

    Of its kind are those that do the same for another seed; where none of them has said what it
    took, for the same algorithm; for any algorithm; or all. Jobs of this kind of processor count,
    or where there is none of those, any. Without any, forecasts stay as they are.

    Raises:
        UserError: what a job says that it took is damaged.
    """
    kinds = {job.product: tuple(_kinds(comparisons, job)) for job in jobs}
    said = [(job, found) for job in jobs if (found := spent.read(spent.beside(job.output)))]
    done = [(job, found) for job, found in said if job.done]
    here = [(job, found) for job, found in done if found.processor == processor()] or done
    took, expected = defaultdict[Kind, float](float), defaultdict[Kind, float](float)
    for job, found in here:
        for kind in kinds[job.product]:
            took[kind] += found.processor_seconds
            expected[kind] += job.seconds

    def times(job: Job) -> float:
        known = (kind for kind in kinds[job.product] if kind in took)
        return next((took[kind] / expected[kind] for kind in known), 1.0)

    return [replace(job, seconds=job.seconds * times(job)) for job in jobs]


def hours(jobs: Iterable[Job]) -> float:
    """What those that are done and have said it took, in hours of one core. Raises UserError."""
    found = [spent.read(spent.beside(job.output)) for job in jobs if job.done]
    return sum(one.processor_seconds for one in found if one) / 3600


def _kinds(comparisons: Sequence[Comparison], job: Job) -> Iterable[Kind]:
    """From the narrowest on."""
    piece = re.sub(r"^seed_\d+_", "", job.output.stem)
    piece = "offline" if piece.startswith("offline_") else piece  # of whichever agent
    for one in comparisons:
        if job.output.is_relative_to(one.folder.root):
            yield one.name, piece
            yield one.base.algorithm.name, piece
    yield (piece,)
    yield ()
