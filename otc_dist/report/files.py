"""The files of a run folder that a report reads, each checked field by field.

What a report does not use is passed over; a field that it uses must have its declared type.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, FiniteFloat
from typing_extensions import TypedDict

from otc_dist.run.folder import RunFolder
from otc_dist.system import records

GOING_ON = ("running", "reporting")  # states of a run that has not ended

_Count = Annotated[int, Field(ge=0, lt=2**53)]


class Record(TypedDict, total=False):
    """What a report uses of run.json."""

    run: str
    command: list[str] | str
    versions: dict[str, str]
    started: str
    finished: str | None
    state: str
    quick: bool
    resumed: list[str]
    extended: list[int]
    origin: str | None


class _Summary(TypedDict):
    mean: float
    std: float
    minimum: float
    maximum: float


class Card(TypedDict, total=False):
    """What must be so in dataset_card.json; a report uses all of it."""

    __pydantic_config__ = ConfigDict(extra="allow")  # type: ignore[misc]

    returns: _Summary | None
    normalised_score: _Summary | None


@dataclass(frozen=True)
class Evaluated:
    """The contents of an evaluation."""

    evaluation: _Count
    returns: Annotated[list[FiniteFloat], Field(min_length=1)]
    lengths: list[_Count]
    seeds: list[int]
    normalised_score: float | None
    policies: Mapping[str, str]
    successes: list[bool] | None = None


@dataclass(frozen=True)
class Line:
    """One line of metrics.jsonl."""

    phase: str
    deployment: _Count
    update: _Count
    metrics: Mapping[str, float | None]
    updates: _Count = 0


def record(path: Path) -> Record:
    """run.json. Raises FileNotFoundError, UserError; so do those below."""
    return records.read_json(Record, path)


def run_record(folder: RunFolder) -> Record:
    """run.json of a run that is only looked at. Raises UserError if `folder` is no run's."""
    try:
        return record(folder.run_json)
    except FileNotFoundError:
        raise folder.lacks(folder.run_json) from None


def card(path: Path) -> Card:
    """dataset_card.json."""
    return records.read_json(Card, path)


def evaluated(path: Path) -> Evaluated:
    """An evaluation."""
    return records.read_json(Evaluated, path)
