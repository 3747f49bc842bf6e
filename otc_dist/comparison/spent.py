"""What the jobs of a comparison took: each says it when it has ended, beside what it printed."""

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field

from otc_dist.comparison.scores import ComparisonFolder, write_json
from otc_dist.system import records
from otc_dist.system.processor import processor
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class Spent:
    """Of a whole process, its imports and the compilers that it called included.

    Attributes:
        processor_seconds: of one core; what one process took for several seeds is shared out.
        seeds: for how many it was.
    """

    processor_seconds: float
    processor: str
    seeds: Annotated[int, Field(ge=1)] = 1

    @classmethod
    def so_far(cls, seeds: int) -> Self:
        """One seed's share of what this process took, and those that it has waited for."""
        now = os.times()
        took = now.user + now.system + now.children_user + now.children_system
        return cls(round(took / seeds, 1), processor(), seeds)

    def write(self, path: Path) -> None:
        """Raises UserError if it cannot be written."""
        write_json(path, asdict(self))


def beside(output: Path) -> Path:
    """Where a job that prints to `output` says what it took."""
    return output.with_suffix(".json")


def read(path: Path) -> Spent | None:
    """None if the job has not said it: it was not done here, or by an earlier version.

    Raises:
        UserError: the file is damaged.
    """
    try:
        return records.read_json(Spent, path)
    except FileNotFoundError:
        return None
    except UserError as error:
        raise UserError(f"{error}; delete it") from None


def kept(path: Path) -> dict[str, Spent]:
    """Job -> what it took, as `SPENT` holds it. Raises UserError if it is damaged."""
    return records.read_json(dict[str, Spent], path)


def of_seed(folder: ComparisonFolder, seed: int) -> dict[str, dict[str, object]]:
    """Job -> what it took, for `SPENT`, of all jobs of a seed that have said it.

    Raises:
        UserError: a file is damaged.
    """
    first = beside(folder.output(seed, "*"))  # all of them, as a pattern
    start, _, _ = first.stem.partition("*")
    found = {path.stem.removeprefix(start): read(path) for path in first.parent.glob(first.name)}
    return {job: asdict(one) for job, one in sorted(found.items()) if one is not None}
