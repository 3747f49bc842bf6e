"""Which job next: in the order that was given, until the longest chains would end last.

What comes first is done first, so that much of the result is early complete. But a long job, or one
that others wait for, must not be left to the end, when other cores have nothing to do any more.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

# A chain is begun when it takes as long as half of what each core has yet to do: of values from 1
# to 3, this one leaves the fewest cores idle at the end without leaving the given order early.
AHEAD = 2.0


class Timed(Protocol):
    """What is known of a job."""

    @property
    def name(self) -> str: ...
    @property
    def product(self) -> Path: ...
    @property
    def needs(self) -> tuple[Path, ...]: ...
    @property
    def seconds(self) -> float: ...


J = TypeVar("J", bound=Timed)


def chains(jobs: Sequence[Timed]) -> dict[str, float]:
    """Job -> seconds from its start to the end of the longest chain of jobs that wait for it.

    Jobs are in an order in which they can be done.
    """
    after: dict[Path, float] = {}  # product -> the longest chain of those that need it
    found: dict[str, float] = {}
    for job in reversed(jobs):
        found[job.name] = job.seconds + after.get(job.product, 0.0)
        for needed in job.needs:
            after[needed] = max(after.get(needed, 0.0), found[job.name])
    return found


def next_job(ready: Sequence[J], chains: Mapping[str, float], left: float, workers: int) -> J:
    """Of those that can start, in the given order: the one to start.

    Args:
        chains: see `chains`.
        left: seconds of all jobs that have not ended.
        workers: how many jobs run at once.
    """
    longest = max(ready, key=lambda job: chains[job.name])
    return longest if AHEAD * chains[longest.name] >= left / workers else ready[0]
