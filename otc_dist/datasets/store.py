"""Where B_0 comes from: each data set is made once, and each agent is given its own file of it.

    <cache>/datasets/<env_id>/<level>/<transitions>/agent_0.safetensors
                                                   /agent_1.safetensors
                                                   /card.json

<cache> is $OTC_DIST_CACHE or the user's cache folder. A set's folder appears by one rename, when
all of it is on the disk.
"""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import otc_dist
from otc_dist.datasets import generate
from otc_dist.datasets.agent_files import load_agent, load_tensors
from otc_dist.datasets.card import DatasetCard, episode_returns, team_rewards
from otc_dist.datasets.joint import JointTransitions
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.source import Source
from otc_dist.datasets.writing import Provenance, locked, publish, versions
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError, unknown
from otc_dist.terminal.progress import Report, silent
from otc_dist.transitions import Float64

__all__ = ["agent_file", "cached", "ensure", "load_agent", "load_joint", "usual_size"]

_SEED = 0  # of all data sets that we make: one name and size, one content

_log = logging.getLogger(__name__)


def usual_size(name: str) -> int:
    """Transitions of the data set if nobody asks for another size. UserError if unknown."""
    return DatasetName.parse(name).usual_size()


def agent_file(name: str, agent: str, transitions: int = 0) -> Path:
    """Where the B_0 of `agent` lies, or will lie. UserError for an unknown data set or agent."""
    parsed = DatasetName.parse(name)
    agents = registry.team_spec(parsed.env_id).names
    if agent not in agents:
        raise unknown("agent", agent, agents)
    return parsed.set_folder(transitions) / f"{agent}.safetensors"


def ensure(
    name: str, transitions: int = 0, report: Report = silent, agents: Sequence[str] = ()
) -> DatasetCard:
    """The data set, verified by its hashes; made first if it is absent, damaged or outdated.

    Two processes may ask for the same set at once: one makes it, the other waits.

    Args:
        agents: whose files are needed on this machine, beside those that are there; empty:
            everybody's.

    Raises:
        UserError: unknown name, size or agent, a damaged imported set, no space or no right to
            write.
    """
    parsed = DatasetName.parse(name)
    wanted, folder = _wanted(parsed, agents), parsed.set_folder(transitions)
    source = parsed.source
    if source is None:
        return _imported(folder, wanted)
    recipe = _recipe(parsed, source)
    card, _ = _inspect(folder, recipe)
    if card is not None and wanted <= set(card.files):
        return card
    with locked(parsed):
        card, fault = _inspect(folder, recipe)
        if card is not None:
            if wanted <= set(card.files):  # another process made it while we waited
                return card
            wanted |= set(card.files)
        if fault is not None:
            _log.warning("making %s again: %s", folder, fault)
        made = generate.generate(parsed.env_id, parsed.level, int(folder.name), _SEED, report)
        returns, incomplete = _returns(parsed, made)
        origin = f"made by otc_dist, seed {_SEED}"
        provenance = Provenance(
            origin,
            recipe,
            versions(*source.packages),
            returns,
            incomplete,
            registry.remarks(parsed.env_id),
        )
        return publish(parsed, made, provenance, sorted(wanted))


def cached(name: str, transitions: int = 0) -> DatasetCard:
    """The card of a set in the cache, its files verified; nothing is made.

    Raises:
        UserError: it is not there, at that size or (0) its usual one, or is damaged.
    """
    parsed = DatasetName.parse(name)
    sizes = parsed.sizes()
    size = transitions or parsed.usual_size()
    if not transitions and size not in sizes and len(sizes) == 1:
        size = sizes[0]  # the only one there is
    if size not in sizes:
        others = f" (there are {', '.join(map(str, sizes))})" if sizes else ""
        raise UserError(
            f"{name} with {size} transitions is not in the cache{others}; make it: "
            f"python -m otc_dist.datasets make {name}"
            + (f" --transitions {transitions}" if transitions else "")
        )
    folder = parsed.set_folder(size)
    card = DatasetCard.read(folder)
    fault = card.fault(folder) if card else "its card is missing or damaged"
    if card is None or fault:
        raise UserError(f"{name} is damaged: {fault}; make or import it again")
    return card


def check(name: str, transitions: int, agents: Sequence[str] = ()) -> bool:
    """Whether the data set is there, for these agents; False if it can be made. Nothing is made.

    Raises:
        UserError: as `ensure`, and what a learner would refuse of an imported set.
    """
    parsed = DatasetName.parse(name)
    wanted, folder = _wanted(parsed, agents), parsed.set_folder(transitions)
    source = parsed.source
    if source is None:
        _imported(folder, wanted)
        for agent in sorted(wanted):
            load_agent(folder / f"{agent}.safetensors", agent)
        return True
    generate.parts(parsed.env_id, parsed.level, int(folder.name))
    card, _ = _inspect(folder, _recipe(parsed, source))
    return card is not None and wanted <= set(card.files)


def _wanted(name: DatasetName, agents: Sequence[str]) -> set[str]:
    """Whose files are needed. Raises UserError for an unknown agent."""
    everybody = registry.team_spec(name.env_id).names
    for agent in agents:
        if agent not in everybody:
            raise unknown("agent", agent, everybody)
    return set(agents or everybody)


def _recipe(name: DatasetName, source: Source) -> dict[str, str]:
    """All that determines the rows of a set that we make."""
    return {
        "level": name.level,
        "seed": str(_SEED),
        "otc_dist": otc_dist.__version__,
        **source.recipe(name.env_id, name.level),
    }


def _returns(name: DatasetName, made: JointTransitions) -> tuple[Float64, int]:
    """Returns of the complete episodes of what was made, and the number of the others."""
    limit, truncated = registry.time_limit(name.env_id), made.truncated
    if not limit:  # the length does not say whether the task ended an episode, or we did
        truncated = truncated.copy()
        stops = [part.stop for part in generate.parts(name.env_id, name.level, len(made))]
        truncated[np.array(stops) - 1] = False
    begun = np.ones(len(made), np.bool_)
    return episode_returns(
        team_rewards(made.rewards), made.terminated, truncated, made.episodes, begun, limit
    )


def _imported(folder: Path, wanted: set[str]) -> DatasetCard:
    card = DatasetCard.read(folder)
    fault = card.fault(folder) if card else "its card is missing or damaged"
    if card is None or fault:
        raise UserError(f"{fault}; delete {folder} and import the data set again")
    if missing := sorted(wanted - set(card.files)):
        raise UserError(f"{folder} has no file of {missing[0]}: import {missing[0]}.safetensors")
    return card


def _inspect(folder: Path, recipe: dict[str, str]) -> tuple[DatasetCard | None, str | None]:
    """The card of the sound and current set in `folder`, or None and what is wrong with it."""
    if not folder.exists():
        return None, None
    card = DatasetCard.read(folder)
    if card is None:
        return None, "its card is missing or damaged"
    if card.recipe != recipe:
        return None, "it was made by another recipe or version"
    fault = card.fault(folder)
    return (None, fault) if fault else (card, None)


def load_joint(name: str, transitions: int = 0) -> JointTransitions:
    """All agents' data, row-aligned, for analysis only: a learner may never see this.

    Raises:
        UserError: as `load_agent`, or files that are not of the same set.
    """
    parsed = DatasetName.parse(name)
    folder = parsed.set_folder(transitions)
    names = registry.team_spec(parsed.env_id).names
    tensors = [load_tensors(folder / f"{agent}.safetensors", agent) for agent in names]
    first = tensors[0]
    for agent, other in zip(names, tensors, strict=True):
        for shared in ("terminated", "truncated", "episodes"):
            if not np.array_equal(first[shared], other[shared]):
                raise UserError(f"{folder}: {agent} and {names[0]} are not of the same set")
    return JointTransitions(
        observations=tuple(t["observations"] for t in tensors),
        actions=tuple(t["actions"] for t in tensors),
        rewards=tuple(t["rewards"] for t in tensors),
        next_observations=tuple(t["next_observations"] for t in tensors),
        terminated=first["terminated"],
        truncated=first["truncated"],
        episodes=first["episodes"],
    )
