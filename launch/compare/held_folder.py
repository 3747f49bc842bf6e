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

from ..plan import descriptions, run_record
from ..plan.new_folder import NewFolder


def check(folder: ComparisonFolder, base: Description) -> None:
    """See that it is, or may become, the folder of a comparison of `base`; nothing is made.

    Raises:
        UserError: it is of another description or other data, or something else's.
    """
    _check_kind(folder)
    _check_same(folder, base)
    _inputs(folder, base)


@contextmanager
def opened(folder: ComparisonFolder, base: Description, quick: bool = False) -> Iterator[NewFolder]:
    """The folder, held against other launchers, with `base` as its description.

    A new one is marked if it is to be a quick look.

    What is refused before any job of it is done leaves nothing: of a new one, all is taken away
    again; in one that was begun before, which may have its jobs in a queue, what has come into it.

    Raises:
        UserError: it is held, cannot be written, or is of another description or other data.
    """
    new = NewFolder(folder.root)
    _check_kind(folder)
    _check_same(folder, base)  # not even a lock in another's
    with run_record.locked(RunFolder(folder.root)):
        begun = folder.description.exists()
        _check_same(folder, base)  # another launcher may have begun it meanwhile
        if not begun:
            if quick:
                durable.write(folder.quick, f"{descriptions.QUICK_LABEL}\n".encode())
            durable.write(folder.description, base.to_toml().encode())
        try:
            note_inputs(folder, base)
            yield new
        except UserError:
            if begun:
                new.take_back()
            else:
                new.take_away()
            raise


def note_inputs(folder: ComparisonFolder, base: Description) -> None:
    """Note what all arms read, as far as it is there, once; later it must be the same.

    Raises:
        UserError: it is not, or cannot be noted.
    """
    noted, now = _inputs(folder, base)
    if now != noted:
        write_json(folder.inputs, now)


def _inputs(folder: ComparisonFolder, base: Description) -> tuple[dict[str, str], dict[str, str]]:
    """What is noted, and what is to be. Raises UserError if they contradict each other."""
    noted = records.read_json(dict[str, str], folder.inputs) if folder.inputs.exists() else {}
    found, agents = inputs.sources(base) | inputs.code(base), registry.team_spec(base.env.id).names
    name, transitions = base.dataset.name, base.dataset.transitions
    if all(store.agent_file(name, agent, transitions).exists() for agent in agents):
        found |= inputs.data(base, agents)
    inputs.check(noted, found, base)
    return noted, {**found, **noted}


def _check_kind(folder: ComparisonFolder) -> None:
    """Raises UserError: what is there is no comparison's folder."""
    if RunFolder(folder.root).run_json.exists():
        raise UserError(
            f"{folder.root} is the folder of a run, not of a comparison; use another --out"
        )
    if next(folder.root.glob("seed_*"), None):  # as `--results` keeps them
        raise UserError(f"{folder.root} holds kept raw scores; use another --out")
    there = folder.root.iterdir() if folder.root.exists() else ()
    found = {path.name for path in there} - {run_record.LOCK}
    if found and folder.description.name not in found:
        raise UserError(f"{folder.root} holds something else; use another --out")


def _check_same(folder: ComparisonFolder, wanted: Description) -> None:
    """Raises UserError, naming the first difference, if it was begun with another description.

    The summary comes last: any `--set` empties it, and what was set says more.
    """
    if not folder.description.exists():
        return
    before, now = _flat(Description.load(folder.description)), _flat(wanted)
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
