"""The card of a data set (`card.json`): what is in it, how good it is, how it was made."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from otc_dist.datasets.agent_files import FORMAT_VERSION
from otc_dist.envs import registry
from otc_dist.names import AgentName, DatasetId, EnvironmentId
from otc_dist.transitions import Bool, Float32, Float64

FILE_NAME = "card.json"


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Summary(_Record):
    """Mean, standard deviation and range of some numbers."""

    mean: float
    std: float
    minimum: float
    maximum: float

    @classmethod
    def of(cls, values: Float64) -> Self | None:
        """None if there are no values."""
        if len(values) == 0:
            return None
        return cls(
            mean=float(values.mean()),
            std=float(values.std()),
            minimum=float(values.min()),
            maximum=float(values.max()),
        )


class AgentFile(_Record):
    """One agent's file of the set."""

    bytes: int
    sha256: str
    observation_size: int
    action_size: int

    @classmethod
    def of(cls, path: Path, observation_size: int, action_size: int) -> Self:
        """The record of a file that is there. Raises OSError if it cannot be read."""
        return cls(
            bytes=path.stat().st_size,
            sha256=file_sha256(path),
            observation_size=observation_size,
            action_size=action_size,
        )


class DatasetCard(_Record):
    """What a data set says of itself. Without a clock: equal data give an equal card."""

    format_version: int = FORMAT_VERSION
    name: DatasetId  # "hopper-3x1/medium"
    env_id: EnvironmentId
    transitions: int
    terminated: int  # transitions where the task ended
    truncated: int  # transitions where a time limit ended the episode
    episodes: int  # complete ones, which the returns are over
    incomplete_episodes: int
    returns: Summary | None  # team return: mean over agents of their sums of rewards
    normalised_score: Summary | None  # 0: random, 100: expert; None where no reference is known
    origin: str
    recipe: dict[str, str]  # all that determines the data; another recipe, other data
    notes: tuple[str, ...]  # what was dropped, reconstructed or assumed
    versions: dict[str, str]
    files: dict[AgentName, AgentFile]  # by agent

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """The card in `folder`, or None if there is none that can be read."""
        try:
            card = cls.model_validate_json((folder / FILE_NAME).read_bytes())
        except (OSError, ValidationError):
            return None
        return card if card.format_version == FORMAT_VERSION else None

    def to_json(self) -> str:
        return self.model_dump_json(indent=2) + "\n"

    def fault(self, folder: Path) -> str | None:
        """What is wrong with the files in `folder`, hashes included; None if nothing is."""
        for agent, expected in self.files.items():
            path = folder / f"{agent}.safetensors"
            try:
                size = path.stat().st_size
                if size != expected.bytes:
                    return f"{path} has {size} bytes instead of {expected.bytes}"
                if file_sha256(path) != expected.sha256:
                    return f"{path} does not match its sha256"
            except OSError as error:
                return f"cannot read {path}: {error.strerror}"
        return None


def file_sha256(path: Path) -> str:
    """Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def episode_returns(
    rewards: Float32 | Float64,
    terminated: Bool,
    truncated: Bool,
    episodes: NDArray[np.int64],
    begun: Bool,
    limit: int,
) -> tuple[Float64, int]:
    """Returns of the complete episodes, in order of their ids, and the number of the others.

    The one rule for data of every source: an episode is complete if it is there from its first
    step on, and terminated, or was truncated at `limit` steps or later: below, something other than
    the task's time limit cut it. All arrays are (T,).

    Args:
        begun: whether the row's episode is there from its first step.
        limit: `registry.time_limit`; 0: the task may truncate at any step.
    """
    ids, members, lengths = np.unique(episodes, return_inverse=True, return_counts=True)
    returns = np.bincount(members, rewards, len(ids)).astype(np.float64)
    fell, cut, late = (
        np.bincount(members, flags, len(ids)) > 0 for flags in (terminated, truncated, ~begun)
    )
    complete = ~late & (fell | (cut & (lengths >= limit)))
    return returns[complete], int((~complete).sum())


def team_rewards(rewards: Sequence[Float32]) -> Float64:
    """A team's rewards (T,) from its agents', N x (T,): their mean."""
    mean: Float64 = np.stack(rewards).mean(axis=0, dtype=np.float64)
    return mean


def normalised_scores(env_id: str, returns: Float64) -> Float64:
    """`returns` on the scale from 0 (random) to 100 (expert); empty where that is not known."""
    scores = [registry.normalised_score(env_id, value) for value in returns.tolist()]
    return np.array([score for score in scores if score is not None], np.float64)
