"""Checkpoints: a learner's tensors and counters in one safetensors file, checked when read."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from otc_dist.system import durable, records
from otc_dist.terminal.errors import UserError

FORMAT = 1
Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class CheckpointMetadata:
    """What a checkpoint says beside its tensors.

    Attributes:
        agent: whose it is.
        offline_digest: of what the offline policy depends on.
        run_digest: of what tuning depends on.
        offline_updates: updates made offline.
        tuned: k of the policy pi_k, or -1 while offline training is unfinished.
        alpha, similarity: of the newest deployment (Eq. 4).
        together: the seeds whose offline updates were made at once; empty: each for itself.
    """

    agent: str
    offline_digest: str
    run_digest: str
    offline_updates: Annotated[int, Field(ge=0)]
    tuned: Annotated[int, Field(ge=-1)]
    alpha: float
    similarity: float
    together: tuple[int, ...] = ()


def digest(arrays: Mapping[str, NDArray[np.generic]]) -> str:
    """16 hexadecimal digits that identify named arrays, to the bit."""
    total = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        total.update(f"{name}{array.dtype}{array.shape}".encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()[:16]


def parts(arrays: Mapping[str, NDArray[np.generic]]) -> dict[str, Arrays]:
    """Arrays named `part.key`, taken apart: part -> key -> array."""
    found: dict[str, Arrays] = {}
    for name, array in arrays.items():
        part, _, key = name.partition(".")
        found.setdefault(part, {})[key] = array
    return found


def joined(states: Mapping[str, Mapping[str, NDArray[np.generic]]]) -> Arrays:
    """The inverse of `parts`."""
    return {f"{part}.{key}": x for part, state in states.items() for key, x in state.items()}


def write(
    path: Path, arrays: Mapping[str, NDArray[np.generic]], progressed: CheckpointMetadata
) -> None:
    """Write atomically: a crash leaves the old file or the new one.

    Raises:
        UserError: the disk is full, or the folder cannot be written.
    """
    about = {"format": FORMAT, **asdict(progressed)}
    about["digest"] = _seal(arrays, about)
    durable.put(path, save(dict(arrays), metadata={"otc_dist": json.dumps(about)}))


def read(path: Path) -> tuple[Arrays, CheckpointMetadata]:
    """Read and check a checkpoint.

    Raises:
        UserError: missing, damaged (its digest does not fit), or of a newer format.
    """
    try:
        with safe_open(path, framework="np") as file:
            text = (file.metadata() or {})["otc_dist"]
            arrays: Arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError:
        raise UserError(f"no checkpoint at {path}") from None
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"the checkpoint {path} is damaged ({error}); delete it") from None
    about = records.from_json(dict[str, object], text, f"the checkpoint {path}")
    if about.pop("digest", None) != _seal(arrays, about):
        raise UserError(f"the checkpoint {path} is damaged (wrong digest); delete it")
    if (version := about.pop("format", None)) != FORMAT:
        raise UserError(
            f"the checkpoint {path} has format {version!r:.60}; this version reads {FORMAT}"
        )
    return arrays, records.from_json(
        CheckpointMetadata, json.dumps(about), f"the checkpoint {path}"
    )


def read_own(path: Path, mine: CheckpointMetadata) -> tuple[dict[str, Arrays], CheckpointMetadata]:
    """Read a checkpoint, by `parts`, that is `mine` to go on from.

    One of offline training fits every description that differs only in how it tunes.

    Raises:
        UserError: as `read`, another agent's, or of another description.
    """
    arrays, found = read(path)
    if found.agent != mine.agent:
        raise UserError(f"the checkpoint {path} is {found.agent}'s, not {mine.agent}'s")
    same_run = found.tuned <= 0 or found.run_digest == mine.run_digest
    if found.offline_digest != mine.offline_digest or not same_run:
        raise UserError(f"the checkpoint {path} was made by another description; use its own")
    return parts(arrays), found


def _seal(arrays: Mapping[str, NDArray[np.generic]], about: Mapping[str, object]) -> str:
    """A digest of the tensors and of what is said about them: alpha matters as weights do."""
    return hashlib.sha256((digest(arrays) + json.dumps(about, sort_keys=True)).encode()).hexdigest()
