"""A comparison's folder while a command works in it: held, and always of the same description."""

from collections.abc import Iterator
from contextlib import contextmanager

from otc_dist.comparison.scores import ComparisonFolder, write_json
from otc_dist.datasets import inputs, store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.run.folder import RunFolder
from otc_dist.system import durable, records
from otc_dist.terminal.errors import UserError

from ..plan import run_record
from ..plan.new_folder import NewFolder


@contextmanager
def opened(folder: ComparisonFolder, base: Description) -> Iterator[NewFolder]:
    """The folder, held against other launchers, with `base` as its description.

    If it is new, and what is done in it is refused before any job is done, it is taken away again.
    One that was begun before may have its jobs in a queue.

    Raises:
        UserError: it is held, cannot be written, or is of another description or other data.
    """
    new = NewFolder(folder.root)
    if RunFolder(folder.root).run_json.exists():
        raise UserError(
            f"{folder.root} is the folder of a run, not of a comparison; use another --out"
        )
    if next(folder.root.glob("seed_*"), None):  # as `--results` keeps them
        raise UserError(f"{folder.root} holds kept raw scores; use another --out")
    found = {path.name for path in folder.root.iterdir()} - {run_record.LOCK}
    if found and folder.description.name not in found:  # not even a lock in it
        raise UserError(f"{folder.root} holds something else; use another --out")
    with run_record.locked(RunFolder(folder.root)):
        if begun := folder.description.exists():
            _same(Description.load(folder.description), base, folder)
        else:
            durable.write(folder.description, base.to_toml().encode())
        try:
            note_inputs(folder, base)
            yield new
        except UserError:
            if not begun:
                new.take_away()
            raise


def note_inputs(folder: ComparisonFolder, base: Description) -> None:
    """Note what all arms read, as far as it is there, once; later it must be the same.

    Raises:
        UserError: it is not, or cannot be noted.
    """
    noted = records.read_json(dict[str, str], folder.inputs) if folder.inputs.exists() else {}
    found, agents = inputs.sources(base) | inputs.code(base), registry.team_spec(base.env.id).names
    name, transitions = base.dataset.name, base.dataset.transitions
    if all(store.agent_file(name, agent, transitions).exists() for agent in agents):
        found |= inputs.data(base, agents)
    inputs.check(noted, found, base)
    if (now := {**found, **noted}) != noted:
        write_json(folder.inputs, now)


def _same(found: Description, wanted: Description, folder: ComparisonFolder) -> None:
    """Raises UserError, naming the first difference.

    The summary comes last: any `--set` empties it, and what was set says more.
    """
    before, now = _flat(found), _flat(wanted)
    for key, value in sorted(now.items(), key=lambda item: item[0] == "summary"):
        if before[key] != value:
            raise UserError(
                f"{folder.root} was begun with {key} = {before[key]}, and this is {value};"
                " use another --out"
            )


def _flat(description: Description) -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in description.model_dump(mode="json").items():
        below = value.items() if isinstance(value, dict) else ()
        flat |= {f"{key}.{name}": item for name, item in below} or {key: value}
    return flat
