"""`--from RUN`: a run begins with the policies pi_0 of another one, and trains none."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from otc_dist.description import Description
from otc_dist.description.distances import FITS
from otc_dist.envs import registry
from otc_dist.learner import checkpoint
from otc_dist.learner.checkpoint import Arrays, CheckpointMetadata
from otc_dist.run.folder import RunFolder
from otc_dist.spec import AgentSpec, TeamSpec
from otc_dist.terminal.errors import UserError


@dataclass(frozen=True)
class Origin:
    """The policies pi_0 of a run, or of a comparison's seed, with what its distances fitted.

    Attributes:
        root: the folder that they come from.
        policies: agent -> its checkpoint's arrays and what it says of them.
    """

    root: Path
    policies: Mapping[str, tuple[Arrays, CheckpointMetadata]]

    @classmethod
    def of(cls, root: Path, description: Description) -> Self:
        """What `description` can begin with.

        What was fitted for a distance by other settings than the description's is left out, and
        fitted anew.

        Raises:
            UserError: no such run; other agents, sizes or algorithm; no policy, or a damaged one.
        """
        root = root.resolve()
        theirs = _description(root)
        mine = registry.team_spec(description.env.id).agents
        _check_agents(root, mine, _team(root, theirs).agents)
        if (differs := _differs(description, theirs)) is not None:
            raise UserError(
                f"the policies of {root} are of another algorithm: {differs} is not this"
                " description's"
            )
        stale = [fit for fit in FITS if getattr(theirs, fit) != getattr(description, fit)]
        policies = {}
        for agent in mine:
            arrays, found = checkpoint.read(RunFolder(root).checkpoint(agent.name, 0))
            if found.agent != agent.name:
                raise UserError(f"{root}: the checkpoint of {agent.name} is {found.agent}'s")
            kept = {name: x for name, x in arrays.items() if name.split(".")[0] not in stale}
            policies[agent.name] = (kept, found)
        return cls(root, policies)

    def begun(self, description: Description) -> Description:
        """A copy that trains nothing offline, and is bound to these very policies."""
        hashed = hashlib.sha256()
        for agent, (arrays, _) in sorted(self.policies.items()):
            own = checkpoint.parts(arrays)["algorithm"]
            hashed.update(f"{agent} {checkpoint.digest(own)} ".encode())
        digest = f"offline.policies='{hashed.hexdigest()[:16]}'"
        return description.with_assignments("offline.updates=0", digest)

    def write(self, folder: RunFolder, description: Description) -> None:
        """Give the agents of a new run their checkpoints. Raises UserError."""
        for agent, (arrays, found) in self.policies.items():
            taken = replace(
                found,
                offline_digest=description.offline_digest(),
                run_digest=description.tuning_digest(),
            )
            checkpoint.write(folder.checkpoint(agent, 0), arrays, taken)


def _description(root: Path) -> Description:
    """Of a run's folder, or of a seed's in a comparison: there it lies two folders above."""
    above = root.parent.parent / "description.toml"
    own = root / "description.toml"
    if (root / "seeds").is_dir():
        raise UserError(f"--from: {root} is a comparison's: name a seed of it, as seeds/seed_00")
    if not own.exists() and root.parent.name == "seeds" and above.exists():
        return Description.load(above)
    if not own.exists():
        raise UserError(f"--from: {RunFolder(root).lacks(own)}")
    return Description.load(own)


def _team(root: Path, description: Description) -> TeamSpec:
    """Raises UserError: the environment is not known here, or is code that is not allowed."""
    try:
        return registry.team_spec(description.env.id)
    except UserError as error:
        raise UserError(f"--from: {root}: {error}") from None


def _check_agents(root: Path, mine: tuple[AgentSpec, ...], theirs: tuple[AgentSpec, ...]) -> None:
    def sizes(agents: tuple[AgentSpec, ...]) -> list[tuple[str, int, int, int]]:
        return [(a.name, a.observation_size, a.action_size, a.choices) for a in agents]

    for own, other in zip(sizes(mine), sizes(theirs), strict=False):
        if own != other:
            raise UserError(
                f"{root} is of other agents: {_sizes(other)} there, and {_sizes(own)} here"
            )
    if len(mine) != len(theirs):
        raise UserError(f"{root} is of other agents: {len(theirs)} there, and {len(mine)} here")


def _sizes(agent: tuple[str, int, int, int]) -> str:
    name, observation, action, choices = agent
    does = f"{choices} choices" if choices else f"actions of {action}"
    return f"{name} with observations of {observation} and {does}"


def _differs(mine: Description, theirs: Description) -> str | None:
    """The first key of the algorithm's section in which they differ, with its value there."""
    here = mine.algorithm.model_dump(mode="json")
    there = theirs.algorithm.model_dump(mode="json")
    for key in ("name", *here, *there):
        if here.get(key) != there.get(key):
            return f"algorithm.{key} = {there.get(key)!r}"
    return None
