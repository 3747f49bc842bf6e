"""What a run has made when it has come to its end, and what of it is missing or damaged."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.learner import checkpoint
from otc_dist.run.folder import RunFolder
from otc_dist.terminal.errors import UserError

from .placement import Placement


def lost_work(folder: RunFolder, description: Description, placement: Placement) -> str | None:
    """The first product of this machine's processes that is missing or damaged, in words."""
    settings, team = description.deployment, registry.team_spec(description.env.id)
    learners = [name for name in placement.processes(team) if name in team.names]
    if damage := damaged_checkpoints(folder, description, placement, learners):
        return damage[0][0]
    wanted: list[Path] = [folder.recommended(name) for name in learners]
    if placement.role != "learner":
        made = settings.total
        if settings.floor is not None:  # which may have ended the deployments
            made = max((k for k in range(made + 1) if folder.deployment(k).exists()), default=0)
        wanted += [folder.deployment(k) for k in range(1, made + 1)]
        if description.evaluation.episodes:
            wanted += [folder.evaluation(k) for k in range(min(made, settings.count) + 1)]
    return next((f"{path} is missing" for path in wanted if not path.exists()), None)


def lost_report(folder: RunFolder, placement: Placement) -> bool:
    """Whether the report, where one is made, or its numbers are not there."""
    written = folder.results.exists() and folder.report.exists()
    return placement.role != "learner" and not written


def damaged_checkpoints(
    folder: RunFolder, description: Description, placement: Placement, learners: Sequence[str]
) -> list[tuple[str, list[Path]]]:
    """Of each agent that has a checkpoint that is missing or damaged: what is wrong with its first,
    and that one and all that follow.
    """
    count, found = description.deployment.count, []
    for agent in learners:
        last = count
        if description.deployment.floor is not None:  # which may have ended the deployments
            known = (
                folder.deployment if placement.role == "all" else partial(folder.checkpoint, agent)
            )
            last = max((k for k in range(1, count + 1) if known(k).exists()), default=0)
        paths = [folder.checkpoint(agent, k) for k in range(last + 1)]
        for index, path in enumerate(paths):
            try:
                checkpoint.read(path)
            except UserError as error:
                found.append((str(error).removesuffix("; delete it"), paths[index:]))
                break
    return found
