"""The episodes of a deployment, found in its steps."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from otc_dist.deployment_log.header import LogHeader
from otc_dist.deployment_log.record import Rows
from otc_dist.system import records
from otc_dist.terminal.errors import UserError

_Count = Annotated[int, Field(ge=0, lt=2**32)]


@dataclass(frozen=True)
class Episode:
    """One episode of one copy. Where neither end is set, the steps ended before it did."""

    seed: int
    copy: _Count
    start: _Count  # the step of the deployment at which it began
    length: Annotated[int, Field(ge=1, lt=2**32)]  # steps
    returns: tuple[float, ...]  # by agent, undiscounted
    terminated: bool
    truncated: bool
    whole: bool = True  # False: earlier steps of it are missing; `start` is its first that is not


def find_episodes(blocks: Iterable[Rows], agents: int) -> list[Episode]:
    """Episodes in order of their start, then of the copy; `blocks` are all steps, in order."""
    rewards_of = tuple(f"rewards.{i}" for i in range(agents))
    columns = ("step", "terminated", "truncated", "episode_seeds", *rewards_of)
    parts = [tuple(rows[name].copy() for name in columns) for rows in blocks]
    if not parts:
        return []
    # Numbers (T,), all others (T, E).
    numbers, terminated, truncated, seeds, *rewards = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    steps, copies = terminated.shape
    missing = np.diff(numbers.astype(np.int64), prepend=-1) != 1  # something before this step is
    after_gaps = np.flatnonzero(missing).tolist()
    episodes = []
    for copy in range(copies):
        ends = np.flatnonzero(terminated[:, copy] | truncated[:, copy])
        starts = sorted({0, *after_gaps, *(int(end) + 1 for end in ends)})
        stops = [*starts[1:], steps]
        for start, stop in zip(starts, stops, strict=True):
            if start == stop:
                continue
            episodes.append(
                Episode(
                    seed=int(seeds[start, copy]),
                    copy=copy,
                    start=int(numbers[start]),
                    length=stop - start,
                    returns=tuple(
                        float(reward[start:stop, copy].sum(dtype=np.float64)) for reward in rewards
                    ),
                    terminated=bool(terminated[stop - 1, copy]),
                    truncated=bool(truncated[stop - 1, copy]),
                    whole=not missing[start],
                )
            )
    return sorted(episodes, key=lambda episode: (episode.start, episode.copy))


def to_json(episodes: Iterable[Episode]) -> str:
    """As a JSON array of objects."""
    return json.dumps([asdict(episode) for episode in episodes])


def from_json(text: str, header: LogHeader, path: Path) -> list[Episode]:
    """Inverse of `to_json`, for a log with that header; `path` is for the message.

    Raises:
        UserError: it is no table of episodes, or not one of such a log.
    """
    found = records.from_json(list[Episode], text, f"{path}: its table of episodes")
    for episode in found:
        if episode.copy >= header.copies or len(episode.returns) != len(header.team.agents):
            raise UserError(f"{path}: its table of episodes is of other copies or agents")
    return found
