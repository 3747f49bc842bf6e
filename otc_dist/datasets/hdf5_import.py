"""Read recordings in HDF5: D4RL's files and Minari's data sets, of single-agent play or joint."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from otc_dist.datasets import d4rl, hdf5, minari, minari_team
from otc_dist.datasets.card import episode_returns, file_sha256
from otc_dist.datasets.found import Found, team_returns
from otc_dist.datasets.recording import split
from otc_dist.datasets.writing import Provenance, versions
from otc_dist.envs import registry
from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError

if TYPE_CHECKING:
    import h5py


def read(source: Path, env_id: str = "") -> Found:
    """Read a D4RL file or a Minari data set.

    Args:
        source: the file, or the data set's folder or its `main_data.hdf5`.
        env_id: whose agents share the action vector; "": the multi-agent version of the robot
            that the file's name (D4RL) or the metadata (Minari) names.

    Raises:
        UserError: no such file, not of these formats, damaged, sizes other than the
            environment's, values that are not finite.
    """
    path = minari.data_file(source) if source.is_dir() else source
    if not path.is_file():
        raise UserError(f"no file {path}")
    recorded_in = minari.environment(path)
    spec = registry.team_spec(env_id or _guess(recorded_in or path.name))
    with hdf5.opened(path) as file:
        found = _read(file, spec, path)
    if recorded_in:
        notes = (f"recorded in {recorded_in}", *found.made.notes)
        found = replace(found, made=replace(found.made, notes=notes))
    return found


def _guess(recorded_in: str) -> str:
    """The environment of that name, or the multi-agent one of the robot whose name begins it."""
    if registry.known(recorded_in):
        return recorded_in
    for env_id, (robot, agents) in PARTITIONS.items():
        if agents > 1 and recorded_in.lower().startswith(robot.name):
            return env_id
    raise UserError(
        f"cannot find the environment from {recorded_in!r}; name it, for example --env hopper-3x1"
    )


def _read(file: "h5py.File", spec: TeamSpec, path: Path) -> Found:
    source = str(path)
    if minari_team.is_joint(file, source):
        data, begun, notes = minari_team.read(file, spec, source)
        returns, incomplete = team_returns(data, begun, spec.env_id)
    else:
        has_episodes = bool(minari.episodes(file, source))
        r = (minari if has_episodes else d4rl).read(file, spec, source)
        data, notes = split(r, spec)
        # Of all that was recorded: transitions without a successor count in an episode's return.
        limit = registry.time_limit(spec.env_id)
        returns, incomplete = episode_returns(
            r.rewards, r.terminated, r.truncated, r.episodes, r.begun, limit
        )
    made = Provenance(
        f"imported from {path.name}",
        {"file": path.name, "sha256": file_sha256(path)},
        versions("h5py", "mujoco"),
        returns,
        incomplete,
        notes,
    )
    return Found(spec, data, made)
