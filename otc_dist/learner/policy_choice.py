"""Which checkpoint of a run is meant, and what makes a policy of it."""

from pathlib import Path
from typing import Annotated, NamedTuple

from pydantic import BaseModel, Field

from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.run.folder import RunFolder
from otc_dist.spec import AgentSpec
from otc_dist.system import records
from otc_dist.terminal.errors import UserError, unknown


class Choice(NamedTuple):
    """A checkpoint, and of what agent and run it is."""

    checkpoint: Path
    description: Description
    agent: AgentSpec


class _Recommended(BaseModel):
    """What counts of `recommended.json`."""

    policy: Annotated[int, Field(strict=True, ge=0, le=10_000)]


def chosen(path: Path, agent: str | None, deployment: int | None) -> Choice:
    """The checkpoint that is meant by a run's folder or by a checkpoint's path.

    Args:
        agent: its name; None: the checkpoint's, or the only one of the run.
        deployment: k of pi_k; None: the checkpoint's, or what the run recommends.

    Raises:
        UserError: there is no such run, agent or checkpoint, or more than one is meant.
    """
    if path.is_dir():
        folder, checkpoint = RunFolder(path), None
    else:
        if agent is not None or deployment is not None:
            raise UserError(f"{path} is one checkpoint: give a run's folder to choose from it")
        folder, checkpoint = RunFolder(path.absolute().parent.parent.parent), path
        if not path.exists():
            raise UserError(f"there is no run and no checkpoint at {path}")
    if not folder.description.exists():
        raise UserError(_no_run(path, folder))
    description = Description.load(folder.description)
    try:
        team = registry.team_spec(description.env.id)
    except UserError as error:
        raise UserError(f"{folder.description}: {error}") from None
    if checkpoint is not None:
        agent = checkpoint.absolute().parent.name
    elif agent is None:
        if len(team.names) > 1:
            raise UserError(f"{path} is of {', '.join(team.names)}: choose one with agent=")
        (agent,) = team.names
    if agent not in team.names:
        raise unknown("agent", agent, team.names)
    if checkpoint is None:
        checkpoint = _of_run(folder, agent, deployment)
    return Choice(checkpoint, description, team.agents[team.index(agent)])


def _no_run(path: Path, folder: RunFolder) -> str:
    if path.is_dir():
        return str(folder.lacks(folder.description))
    return (
        f"{path} is not in a run folder: what its tensors mean is in {folder.description.name},"
        " two folders above it"
    )


def _of_run(folder: RunFolder, agent: str, deployment: int | None) -> Path:
    """The checkpoint of an agent. Raises UserError."""
    if deployment is None:
        path = folder.recommended(agent)
        try:
            deployment = records.read_json(_Recommended, path).policy
        except FileNotFoundError:
            raise UserError(
                f"{folder.root} is not finished and recommends no policy yet: choose one by"
                f" deployment= ({_there(folder, agent)})"
            ) from None
    checkpoint = folder.checkpoint(agent, deployment)
    if not checkpoint.exists():
        raise UserError(f"no checkpoint at {checkpoint} ({_there(folder, agent)})")
    return checkpoint


def _there(folder: RunFolder, agent: str) -> str:
    """For which deployments there are checkpoints, in words."""
    names = (path.stem for path in folder.agent(agent).glob("checkpoint_*.safetensors"))
    found = sorted(int(k) for name in names if (k := name.removeprefix("checkpoint_")).isdecimal())
    return f"there are {', '.join(map(str, found))}" if found else "there are none"
