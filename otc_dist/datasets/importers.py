"""Import recordings: others' files, one module a format, and our own deployment logs."""

from collections.abc import Sequence
from pathlib import Path

from otc_dist.datasets import hdf5_import, lerobot, og_marl, ros_import
from otc_dist.datasets.card import DatasetCard
from otc_dist.datasets.found import Found, team_returns
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.lerobot import is_lerobot
from otc_dist.datasets.log_import import is_log, read_logs
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.own_file import import_agent_file, is_agent_file
from otc_dist.datasets.vault import is_vault
from otc_dist.datasets.writing import Provenance, locked, publish, versions
from otc_dist.names import checked
from otc_dist.terminal.errors import UserError
from otc_dist.terminal.progress import Report, silent


def import_files(
    sources: Sequence[Path],
    level: str = "",
    env_id: str = "",
    report: Report = silent,
    mapping: Path | None = None,
) -> DatasetCard:
    """Import deployment logs, joined, or one file of another kind; see those functions.

    An agent's own file, copied from another machine, keeps the name of its set.

    Args:
        mapping: the mapping file of a ROS 2 recording, which the one source then is.

    Raises:
        UserError: as they do; several files that are not all logs, no level where one is needed.
    """
    if mapping is not None:
        return import_recording(sources, mapping, level, env_id)
    if all(map(is_log, sources)):
        return import_logs(sources, level, env_id, report)
    for source in sources:
        if not source.exists():
            raise UserError(f"there is no {source}")
        if (source / "run.json").exists() or (source.is_dir() and source.name == "deployments"):
            raise UserError(f"{source} is a folder; a run's logs are RUN/deployments/*.mcap")
    if len(sources) == 1 and is_agent_file(sources[0]):
        if level or env_id:
            flag = "--name" if level else "--env"
            raise UserError(f"{sources[0]} says which set it is of: leave out {flag}")
        return import_agent_file(sources[0])
    first = next(source for source in sources if not is_log(source))
    if len(sources) > 1:
        raise UserError(
            f"{first} is not a deployment log, and only logs are joined: import it alone"
        )
    _ask_for_name(first, level)
    return import_file(first, level, env_id)


def import_logs(
    sources: Sequence[Path], level: str = "", env_id: str = "", report: Report = silent
) -> DatasetCard:
    """Import deployment logs as the data set `<env_id>/<level>` and return its card.

    To import the same files again changes nothing.

    Args:
        level: the name after the slash; "": the name of the run that the logs are of.
        env_id: what the logs were recorded in, if it is to be checked.
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
        raise UserError(f"these are logs of {len(logged.runs)} runs: name the result with --name")
    name = _name(team.env_id, level or logged.runs[0])
    if not len(data):
        raise UserError(f"{sources[0]}: there is no whole step in it")
    returns, incomplete = team_returns(data, logged.begun, team.env_id)
    origin = f"deployment logs of {', '.join(logged.runs)}"
    made = Provenance(origin, logged.recipe, versions("mcap"), returns, incomplete, logged.notes)
    return _publish(name, data, made)


def import_file(source: Path, level: str, env_id: str = "") -> DatasetCard:
    """Import `source` as the data set `<env_id>/<level>` and return its card.

    To import the same file again changes nothing.

    Args:
        source: what the `read` of one of the formats' modules takes.
        level: the name after the slash; not one of those that we make.
        env_id: whose agents' data they are; "": what the source or its name says.

    Raises:
        UserError: as that `read`; nothing is left of it, a name that is taken; a full disk.
    """
    _check_level(level)
    reader = og_marl if is_vault(source) else lerobot if is_lerobot(source) else hdf5_import
    return _named(reader.read(source, env_id), source, level)


def import_recording(
    sources: Sequence[Path], mapping: Path, level: str, env_id: str
) -> DatasetCard:
    """Import the one recording of ROS 2 as the data set `<env_id>/<level>` and return its card.

    Raises:
        UserError: as `ros_import.read`; several sources, nothing is left, a name that is taken.
    """
    if len(sources) > 1:
        raise UserError("a mapping file is for one recording: a file, or the folder of its files")
    _ask_for_name(sources[0], level)
    _check_level(level)
    return _named(ros_import.read(sources[0], mapping, env_id), sources[0], level)


def _named(found: Found, source: Path, level: str) -> DatasetCard:
    if not len(found.data):
        raise UserError(f"{source}: nothing is left of it: {'; '.join(found.made.notes)}")
    return _publish(_name(found.team.env_id, level), found.data, found.made)


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


def _ask_for_name(source: Path, level: str) -> None:
    if not level:
        raise UserError(f"name the data of {source}, for example --name mine")


def _check_level(level: str) -> None:
    try:
        checked(level)
    except ValueError as error:
        raise UserError(f"a data set cannot have this name: {error}") from None


def _name(env_id: str, level: str) -> DatasetName:
    _check_level(level)
    name = DatasetName(env_id, level)
    if name.source:
        raise UserError(f"{name} is the name of a data set that we make; choose another --name")
    return name
