"""Import recordings: D4RL's HDF5 files, Minari's data sets, and our own deployment logs."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from otc_dist.datasets import d4rl, hdf5, minari, minari_team
from otc_dist.datasets.card import DatasetCard, episode_returns, file_sha256, team_rewards
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.log_import import is_log, read_logs
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.own_file import import_agent_file, is_agent_file
from otc_dist.datasets.recording import split
from otc_dist.datasets.writing import Provenance, locked, publish, versions
from otc_dist.envs import registry
from otc_dist.envs.robot_specs import PARTITIONS
from otc_dist.names import checked
from otc_dist.spec import TeamSpec
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.progress import Report, silent
from otc_dist.transitions import Bool, Float64

if TYPE_CHECKING:
    import h5py


def import_files(
    sources: Sequence[Path], level: str = "", env_id: str = "", report: Report = silent
) -> DatasetCard:
    """Import deployment logs, joined, or one file of another kind; see those functions.

    An agent's own file, copied from another machine, keeps the name of its set.

    Raises:
        UserError: as they do; several files that are not all logs, no level where one is needed.
    """
    if all(map(is_log, sources)):
        return import_logs(sources, level, env_id, report)
    for source in sources:
        if not source.exists():
            raise UserError(f"there is no {source}")
    if len(sources) == 1 and is_agent_file(sources[0]):
        if level or env_id:
            flag = "--name" if level else "--env"
            raise UserError(f"{sources[0]} says which set it is of: leave out {flag}")
        return import_agent_file(sources[0])
    first = next(source for source in sources if not is_log(source))
    if len(sources) > 1:
        raise UserError(f"{first} is no deployment log, and only those are joined: import it alone")
    if not level:
        raise UserError(f"say what the data of {first} shall be called, for example --name mine")
    return import_file(first, level, env_id)


def import_logs(
    sources: Sequence[Path], level: str = "", env_id: str = "", report: Report = silent
) -> DatasetCard:
    """Import deployment logs as the data set `<env_id>/<level>` and return its card.

    To import the same files again changes nothing.

    Args:
        level: the name after the slash; "": the name of the run that the logs are of.
        env_id: what the logs were recorded in, if it shall be checked.
        report: called with (logs read, of how many).

    Raises:
        UserError: as `read_logs`; logs of several runs and no level; another environment than
            `env_id`; a name that is taken; a full disk.
    """
    logged = read_logs(sources, report)
    team, data = logged.team, logged.data
    if env_id not in ("", team.env_id):
        raise UserError(f"{sources[0]} was recorded in {team.env_id}, not in {env_id}")
    if not level and len(logged.runs) > 1:
        raise UserError(f"these are logs of {len(logged.runs)} runs: say --name for what they make")
    name = _name(team.env_id, level or logged.runs[0])
    if not len(data):
        raise UserError(f"{sources[0]}: there is no whole step in it")
    returns, incomplete = _returns(data, logged.begun, registry.time_limit(team.env_id))
    origin = f"deployment logs of {', '.join(logged.runs)}"
    made = Provenance(origin, logged.recipe, versions("mcap"), returns, incomplete, logged.notes)
    return _publish(name, data, made)


def import_file(source: Path, level: str, env_id: str = "") -> DatasetCard:
    """Import `source` as the data set `<env_id>/<level>` and return its card.

    To import the same file again changes nothing.

    Args:
        source: a D4RL file, or a Minari data set, of single-agent play or joint: its folder or its
            `main_data.hdf5`.
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
        data, notes, (returns, incomplete) = _read(file, spec, str(path))
    recipe = {"file": path.name, "sha256": file_sha256(path)}
    if not len(data):
        raise UserError(f"{path}: nothing is left of it: {'; '.join(notes)}")
    if recorded_in:
        notes = (f"recorded in {recorded_in}", *notes)
    origin = f"imported from {path.name}"
    made = Provenance(origin, recipe, versions("h5py", "mujoco"), returns, incomplete, notes)
    return _publish(name, data, made)


def _publish(name: DatasetName, data: JointTransitions, made: Provenance) -> DatasetCard:
    """Write the data set, or find it there from the same sources."""
    with locked(name):
        if not name.sizes():
            return publish(name, data, made)
        folder = name.set_folder()
        card = DatasetCard.read(folder)
        if card is None or card.recipe != made.recipe or card.fault(folder):
            raise UserError(
                f"{name} is there already, from another file or damaged; "
                f"choose another --name, or delete {name.folder}"
            )
        return card


def _guess(recorded_in: str) -> str:
    """The environment of that name, or the multi-agent one of the robot whose name begins it."""
    if registry.known(recorded_in):
        return recorded_in
    for env_id, (robot, agents) in PARTITIONS.items():
        if agents > 1 and recorded_in.lower().startswith(robot.name):
            return env_id
    raise UserError(
        f"cannot tell the environment from {recorded_in!r}; say it, for example --env hopper-3x1"
    )


def _name(env_id: str, level: str) -> DatasetName:
    try:
        checked(level)
    except ValueError as error:
        raise UserError(f"a data set cannot be called so: {error}") from None
    name = DatasetName(env_id, level)
    if name.source:
        raise UserError(f"{name} is the name of a data set that we make; choose another --name")
    return name


def _read(
    file: "h5py.File", spec: TeamSpec, source: str
) -> tuple[JointTransitions, tuple[str, ...], tuple[Float64, int]]:
    """A team's data, notes, and the returns of its complete episodes with the number of others."""
    limit = registry.time_limit(spec.env_id)
    if minari_team.is_joint(file, source):
        data, begun, notes = minari_team.read(file, spec, source)
        return data, notes, _returns(data, begun, limit)
    has_episodes = bool(minari.episodes(file, source))
    recording = (minari if has_episodes else d4rl).read(file, spec, source)
    data, notes = split(recording, spec)
    # Of all that was recorded: transitions without a successor count in an episode's return.
    r = recording
    found = episode_returns(r.rewards, r.terminated, r.truncated, r.episodes, r.begun, limit)
    return data, notes, found


def _returns(data: JointTransitions, begun: Bool, limit: int) -> tuple[Float64, int]:
    rewards = team_rewards(data.rewards)
    return episode_returns(rewards, data.terminated, data.truncated, data.episodes, begun, limit)
