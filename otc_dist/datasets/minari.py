"""Read Minari data sets in HDF5: one group an episode, with one observation more than actions.

    episode_k/{observations (T + 1, O), actions (T, A), rewards, terminations, truncations}

The last observation is there, so every transition has its true successor.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets.hdf5 import array, attributes, names
from otc_dist.datasets.recording import EpisodeStarts, Recording, flags, joint_sizes, numbers
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError

if TYPE_CHECKING:
    import h5py

_NUMBER = re.compile(r"[0-9]{1,18}")
DATA_FILE = "main_data.hdf5"
OUR_ENVIRONMENT = "environment"  # where the description of an export of ours names it
EPISODE = "episode_"
_FIELDS = ("observations", "actions", "rewards", "terminations", "truncations")


def data_file(folder: Path) -> Path:
    """The HDF5 file of the one data set in `folder`, its root or its `data` folder.

    Raises:
        UserError: none, several, or one in a format other than HDF5.
    """
    for candidate in (folder / DATA_FILE, folder / "data" / DATA_FILE):
        if candidate.is_file():
            return candidate
    found = sorted(folder.rglob(DATA_FILE))
    if found:
        raise UserError(f"{folder} is not a single Minari data set; name one, such as {found[0]}")
    raise UserError(
        f"no {DATA_FILE} in {folder}; only Minari data sets in the format 'hdf5' can be imported"
    )


def environment(path: Path) -> str:
    """The environment id that the metadata beside the data file name, or "": Minari's, or ours."""
    for field, name in (("env_spec", "id"), ("description", OUR_ENVIRONMENT)):
        try:
            metadata = json.loads((path.parent / "metadata.json").read_text(encoding="utf-8"))
            return str(json.loads(metadata[field])[name])
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            continue
    return ""


def episodes(file: "h5py.File", source: str) -> list[str]:
    """The names of the episodes, in their order. Raises UserError: damage."""
    found = [name for name in names(file, source) if name.startswith(EPISODE)]
    if bad := [name for name in found if not _NUMBER.fullmatch(name.removeprefix(EPISODE))]:
        raise UserError(f"{source}: {bad[0]} is not the name of an episode")
    return sorted(found, key=lambda name: int(name.removeprefix(EPISODE)))


def place(attributes: Mapping[str, object]) -> tuple[int, int, int] | None:
    """Log, copy and step of an episode's first row, which our exports give in its attributes."""
    found = [attributes.get(f"options/{name}") for name in ("log", "copy", "step")]
    if not all(isinstance(number, int | np.integer) for number in found):
        return None
    log, copy, step = (int(str(number)) for number in found)
    return log, copy, step


def read(file: "h5py.File", spec: TeamSpec, source: str) -> Recording:
    """Read an open data file.

    Raises:
        UserError: damage, missing arrays, sizes other than the environment's, or bad values.
    """
    width, action_size = joint_sizes(spec, source)
    parts: dict[str, list[NDArray[Any]]] = {
        name: [] for name in (*_FIELDS, "next", "episodes", "begun")
    }
    beginnings = EpisodeStarts()
    for index, name in enumerate(episodes(file, source)):
        where = f"{source}: {name}"
        group = {}
        for field in _FIELDS:
            found = array(file, f"{name}/{field}", source)
            if found is None:
                raise UserError(f"{where} has no array {field}; only plain vectors can be imported")
            group[field] = found
        actions = numbers(group["actions"], "actions", (-1, action_size), where)
        length = len(actions)
        seen = numbers(group["observations"], "observations", (length + 1, width), where)
        parts["observations"].append(seen[:-1])
        parts["next"].append(seen[1:])
        parts["actions"].append(actions)
        parts["rewards"].append(numbers(group["rewards"], "rewards", (length,), where))
        for field in ("terminations", "truncations"):
            parts[field].append(flags(group[field], field, length, where))
        parts["episodes"].append(np.full(length, index, np.int64))
        ended = bool(parts["terminations"][-1][-1:].any() | parts["truncations"][-1][-1:].any())
        whole = beginnings.has(place(attributes(file, name, source)), length, ended)
        parts["begun"].append(np.full(length, whole, np.bool_))
    if not sum(map(len, parts["rewards"])):
        raise UserError(f"{source} is empty")
    joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return Recording(
        observations=joined["observations"],
        actions=joined["actions"],
        rewards=joined["rewards"],
        next_observations=joined["next"],
        known=np.ones(len(joined["rewards"]), np.bool_),
        terminated=joined["terminations"],
        truncated=joined["truncations"] & ~joined["terminations"],
        episodes=joined["episodes"],
        begun=joined["begun"],
        notes=(),
    )
