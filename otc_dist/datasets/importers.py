"""Import recordings that others made: D4RL's HDF5 files and Minari's data sets."""

from pathlib import Path
from typing import TYPE_CHECKING

from otc_dist.datasets import d4rl, hdf5, minari
from otc_dist.datasets.card import DatasetCard, episode_returns, file_sha256
from otc_dist.datasets.names import DatasetName, plain
from otc_dist.datasets.recording import Recording, split
from otc_dist.datasets.writing import Provenance, locked, publish, versions
from otc_dist.envs import registry
from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.errors import UserError
from otc_dist.spec import TeamSpec

if TYPE_CHECKING:
    import h5py


def import_file(source: Path, level: str, env_id: str = "") -> DatasetCard:
    """Import `source` as the data set `<env_id>/<level>` and return its card.

    To import the same file again changes nothing.

    Args:
        source: a D4RL file, or a Minari data set: its folder or its `main_data.hdf5`.
        level: the name after the slash; not one of those that we make.
        env_id: whose agents share the action vector; "": the multi-agent version of the robot
            that the file's name (D4RL) or the metadata (Minari) names.

    Raises:
        UserError: no such file, not of these formats, damaged, sizes other than the
            environment's, values that are not finite, a name that is taken; a full disk.
    """
    path = minari.data_file(source) if source.is_dir() else source
    if not path.is_file():
        raise UserError(f"no file {path}")
    recorded_in = minari.environment(path)
    spec = registry.team_spec(env_id or _guess(recorded_in or path.name))
    name = _name(spec.env_id, level)
    with hdf5.opened(path) as file:
        recording = _read(file, spec, str(path))
    recipe = {"file": path.name, "sha256": file_sha256(path)}
    data, notes = split(recording, spec)
    if not len(data):
        raise UserError(f"{path}: nothing is left of it: {'; '.join(notes)}")
    if recorded_in:
        notes = (f"recorded in {recorded_in}", *notes)
    # Of all that was recorded: transitions without a successor count in an episode's return.
    returns, incomplete = episode_returns(
        recording.rewards, recording.terminated, recording.truncated, recording.episodes
    )
    origin = f"imported from {path.name}"
    made = Provenance(origin, recipe, versions("h5py", "mujoco"), returns, incomplete, notes)
    with locked(name):
        if not name.sizes():
            return publish(name, data, made)
        folder = name.set_folder()
        card = DatasetCard.read(folder)
        if card is None or card.recipe != recipe or card.fault(folder):
            raise UserError(
                f"{name} is there already, from another file or damaged; "
                f"choose another --name, or delete {name.folder}"
            )
        return card


def _guess(recorded_in: str) -> str:
    """The multi-agent environment of the robot with whose name `recorded_in` begins."""
    for env_id, (robot, agents) in PARTITIONS.items():
        if agents > 1 and recorded_in.lower().startswith(robot.name):
            return env_id
    raise UserError(
        f"cannot tell the environment from {recorded_in!r}; say it, for example --env hopper-3x1"
    )


def _name(env_id: str, level: str) -> DatasetName:
    if not plain(level):
        raise UserError(f"{level!r} cannot be a data set's name: use letters, digits and _.-")
    name = DatasetName(env_id, level)
    if name.source:
        raise UserError(f"{name} is the name of a data set that we make; choose another --name")
    return name


def _read(file: "h5py.File", spec: TeamSpec, source: str) -> Recording:
    if any(name.startswith(minari.EPISODE) for name in hdf5.names(file, source)):
        return minari.read(file, spec, source)
    return d4rl.read(file, spec, source)
