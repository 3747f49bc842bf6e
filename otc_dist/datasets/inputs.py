"""What a run reads beside its description, by digests: to continue it, the same are needed.

run.json holds them under `inputs`, by names that `sources` and `data` give.
"""

from collections.abc import Iterable, Mapping

from otc_dist.datasets import store
from otc_dist.datasets.card import file_sha256
from otc_dist.description import Description, user_code
from otc_dist.envs import own_sources, registry
from otc_dist.names import is_code
from otc_dist.terminal.errors import UserError

Digests = Mapping[str, str]  # name of an input -> its SHA-256
_SOURCE = "source "
_CODE = "code of "


def sources(description: Description) -> dict[str, str]:
    """The files of an environment of the user's own; none of the package's.

    Raises:
        UserError: it cannot be made.
    """
    found = registry.sources(description.env.id)
    return {f"{_SOURCE}{path}": digest for path, digest in found.items()}


def code(description: Description) -> dict[str, str]:
    """The files of an algorithm, and of what sampling is made of, of the user's own.

    Raises:
        UserError: one cannot be loaded.
    """
    found: dict[str, str] = {}
    for reference in filter(is_code, description.parts):
        user_code.named(reference)
        loaded = user_code.brought(reference)
        files = own_sources.digests(reference.partition(":")[0], loaded)
        found |= {f"{_CODE}{reference}: {path}": digest for path, digest in files.items()}
    return found


def data(description: Description, agents: Iterable[str]) -> dict[str, str]:
    """The data files of these agents.

    Raises:
        UserError: one cannot be read.
    """
    dataset, found = description.dataset, {}
    for agent in agents:
        path = store.agent_file(dataset.name, agent, dataset.transitions)
        try:
            found[f"data of {agent}"] = file_sha256(path)
        except OSError as error:
            raise UserError(f"cannot read {path}: {error.strerror}") from None
    return found


def check(noted: Digests, found: Digests, description: Description) -> None:
    """Refuse to go on with others than were noted; what was never noted is not judged.

    Raises:
        UserError: one differs; it is named.
    """
    for name, digest in found.items():
        if noted.get(name, digest) == digest:
            continue
        if name.startswith(_SOURCE):
            raise UserError(
                f"{name.removeprefix(_SOURCE)}, which {description.env.id} loads, has changed"
                " since the run began: restore it, or start a new run"
            )
        if name.startswith(_CODE):
            reference, _, path = name.removeprefix(_CODE).rpartition(": ")
            raise UserError(
                f"{path}, of {reference}, has changed since the run began: restore it, or start"
                " a new run"
            )
        raise UserError(
            f"the {name} ({description.dataset.name}) have changed since the run began: import"
            " them again as they were, or start a new run"
        )
