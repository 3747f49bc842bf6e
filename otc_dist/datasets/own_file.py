"""Import one agent's file of a set that lies on another machine: all that its learner needs."""

from pathlib import Path

import numpy as np

from otc_dist.datasets.agent_files import read_file
from otc_dist.datasets.card import FILE_NAME, AgentFile, DatasetCard, episode_returns
from otc_dist.datasets.names import DatasetName
from otc_dist.datasets.writing import add_file, locked
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError


def is_agent_file(path: Path) -> bool:
    """Whether `path` is named like one."""
    return path.suffix == ".safetensors"


def import_agent_file(source: Path) -> DatasetCard:
    """Put an agent's file where the learner of that agent looks for it; returns the set's card.

    To import the same file again changes nothing.

    Raises:
        UserError: no such file, damaged, of a set that is made here as well as elsewhere, or of
            another one than the set of that name which is here; a full disk.
    """
    header, tensors = read_file(source)
    name = DatasetName(header.env_id, header.dataset.rpartition("/")[2])
    if name.source:
        make = f"make {name} --transitions {header.transitions} --agent {header.agent}"
        raise UserError(f"{source} can be made here alike: python -m otc_dist.datasets {make}")
    _, cut = episode_returns(
        tensors["rewards"],
        tensors["terminated"],
        tensors["truncated"],
        tensors["episodes"],
        np.ones(header.transitions, np.bool_),
        registry.time_limit(header.env_id),
    )
    own = AgentFile.of(source, header.observation_size, header.action_size)
    card = DatasetCard(
        name=str(name),
        env_id=header.env_id,
        transitions=header.transitions,
        terminated=int(tensors["terminated"].sum()),
        truncated=int(tensors["truncated"].sum()),
        episodes=len(np.unique(tensors["episodes"])) - cut,
        incomplete_episodes=cut,
        returns=None,
        normalised_score=None,
        origin=header.origin,
        recipe={"imported as": "one agent's file"},
        notes=("returns are the team's: one agent's file does not tell them",),
        versions=header.versions,
        files={header.agent: own},
    )
    folder = name.folder / str(header.transitions)
    with locked(name):
        before = DatasetCard.read(folder)
        if before is not None:
            if before.files.get(header.agent, own) != own or before.origin != header.origin:
                raise UserError(f"{name} is there already and differs; delete {folder} first")
            card = before.model_copy(update={"files": {**before.files, header.agent: own}})
        add_file(folder / f"{header.agent}.safetensors", source.read_bytes())
        add_file(folder / FILE_NAME, card.to_json().encode())
    return card
