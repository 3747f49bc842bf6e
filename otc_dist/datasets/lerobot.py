"""Read LeRobot's data sets, format v3: one row a frame, which is a step here.

    meta/info.json                        version, features, and what robot it was
    data/chunk-000/file-000.parquet       observation.state, action, next.reward, next.done, ...
    meta/episodes/chunk-000/*.parquet     a row an episode

The state and the action are those of a team that all see the same, or of all agents one behind the
other. The last frame of an episode has no successor, and is dropped; our own exports have it as
`next.observation.state`, with `next.terminated` and `next.truncated`.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from otc_dist.datasets import parquet
from otc_dist.datasets.found import Found, begun_episodes, kept, left_out
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.recording import flags, numbers
from otc_dist.datasets.stored import files_sha256, regular_files
from otc_dist.datasets.writing import Provenance, versions
from otc_dist.envs import registry
from otc_dist.names import from_text
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Bool, Float32

_INFO = Path("meta", "info.json")
_LARGEST_INFO = 2**24  # bytes
_STATE, _NEXT_STATE, _DONE = "observation.state", "next.observation.state", "next.done"
_TERMINATED, _TRUNCATED = "next.terminated", "next.truncated"
_REQUIRED = (_STATE, "action", "next.reward", "episode_index", "index")
_WANTED = {*_REQUIRED, _NEXT_STATE, _DONE, _TERMINATED, _TRUNCATED}
_PLACES = ("log", "copy", "step")  # of an episode's first frame, in our exports
_BOOKKEEPING = {"timestamp", "frame_index", "task_index"}
_Columns = Mapping[str, NDArray[Any]]  # (T, n) each


def is_lerobot(path: Path) -> bool:
    """Whether that is a LeRobot data set's folder."""
    return (path / _INFO).is_file()


def read(root: Path, env_id: str) -> Found:
    """Read a data set.

    Args:
        env_id: whose observations and actions they are; "": what the set says the robot is.

    Raises:
        UserError: pyarrow is not installed; another version, damage, missing features, sizes other
            than the environment's, or bad values.
    """
    robot = _robot(root)
    if not env_id and not registry.known(robot):
        raise UserError(f"{root} does not say what environment it is of: say it with --env")
    team = registry.team_spec(env_id or robot)
    files = regular_files(root, "data/*/*.parquet")
    if not files:
        raise UserError(f"{root} has no data/*/*.parquet")
    columns = parquet.read(files, _WANTED)
    if missing := [name for name in _REQUIRED if name not in columns]:
        raise UserError(f"{root} has no {', '.join(missing)}")
    data, known, notes = _rows(columns, team, str(root))
    about = regular_files(root, "meta/episodes/*/*.parquet")
    places = parquet.read(about, _PLACES) if about else {}
    starts = [places[name][:, 0] for name in _PLACES if name in places]
    begun = begun_episodes(data, starts if len(starts) == len(_PLACES) else None)
    left = kept(data, begun, known, team, str(root))
    features = set(parquet.columns_of(files[0])) - _WANTED - _BOOKKEEPING
    features |= {path.name for path in (root / "videos").glob("*")}
    others = left_out("features", sorted(map(from_text, features)))
    made = Provenance(
        f"imported from the LeRobot data set {root.resolve().name}",
        {"folder": root.resolve().name, "sha256": files_sha256(root, [*files, *about])},
        versions("pyarrow"),
        left.returns,
        left.incomplete,
        (f"recorded with the robot {from_text(robot)}", *notes, *left.notes, *others),
    )
    return Found(team, left.data, made)


def _robot(root: Path) -> str:
    """What robot it was. Raises UserError: another version, or no such file."""
    path = root / _INFO
    try:
        if path.stat().st_size > _LARGEST_INFO:
            raise ValueError
        info = json.loads(path.read_text(encoding="utf-8"))
        version, robot = str(info["codebase_version"])[:20], info.get("robot_type")
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise UserError(f"{path} cannot be read, or is not LeRobot's") from None
    if not version.startswith("v3."):
        raise UserError(f"{root} is of LeRobot's format {version!r}; v3.0 is read")
    return str(robot)


def _rows(
    columns: _Columns, team: TeamSpec, source: str
) -> tuple[JointTransitions, Bool, tuple[str, ...]]:
    """All frames in their order, whether s' is known, and notes."""
    length, index = len(columns["index"]), columns["index"][:, 0]
    episodes = columns["episode_index"][:, 0]
    if index.dtype.kind not in "iu" or not np.array_equal(index, np.arange(length)):
        raise UserError(
            f"{source}: the frames of the data files are not 0, 1, 2, ... by their index"
        )
    if episodes.dtype.kind not in "iu" or (np.diff(episodes) < 0).any():
        raise UserError(f"{source}: episode_index is not ascending")
    if not length:
        raise UserError(f"{source} is empty")

    def ends(name: str) -> Bool | None:
        return flags(columns[name], name, length, source) if name in columns else None

    last = np.diff(episodes, append=-1) != 0
    notes: tuple[str, ...] = ()
    terminated, truncated, done = map(ends, (_TERMINATED, _TRUNCATED, _DONE))
    if terminated is None:
        terminated = np.zeros(length, np.bool_)
        notes = (f"no {_TERMINATED} in it: whether a task had ended is not known",)
    if truncated is None:
        truncated = (last if done is None else done) & ~terminated
    seen, joint = _observed(columns, _STATE, team, source)
    if _NEXT_STATE in columns:
        successors, _ = _observed(columns, _NEXT_STATE, team, source)
        known = np.ones(length, np.bool_)
    else:
        successors, known = tuple(np.roll(rows, -1, axis=0) for rows in seen), ~last
    if not joint:
        notes += ("all agents see the whole state",)
    sizes = [agent.action_size for agent in team.agents]
    rewards = columns["next.reward"]
    if rewards.shape[1] == 1:
        rewards = np.repeat(rewards, len(team.agents), axis=1)
    each = numbers(rewards, "next.reward", (length, len(team.agents)), source)
    data = JointTransitions(
        observations=seen,
        actions=_split(columns["action"], "action", sizes, source),
        rewards=tuple(each.T),
        next_observations=successors,
        terminated=terminated,
        truncated=truncated,
        episodes=episodes.astype(np.int64),
    )
    return data, known, notes


def _observed(
    columns: _Columns, name: str, team: TeamSpec, source: str
) -> tuple[tuple[Float32, ...], bool]:
    """N x (T, O), and whether each agent has its own."""
    sizes = [agent.observation_size for agent in team.agents]
    found = columns[name]
    if len(set(sizes)) == 1 < len(sizes) and found.shape[1] == sizes[0]:
        return (numbers(found, name, (-1, sizes[0]), source),) * len(sizes), False
    return _split(found, name, sizes, source), True


def _split(
    array: NDArray[Any], name: str, sizes: Sequence[int], source: str
) -> tuple[Float32, ...]:
    """Vectors of all agents, one behind the other, as N x (T, size)."""
    joint = numbers(array, name, (-1, sum(sizes)), source)
    return tuple(map(np.ascontiguousarray, np.split(joint, np.cumsum(sizes)[:-1], axis=1)))
