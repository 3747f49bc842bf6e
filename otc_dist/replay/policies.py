"""Whether the policies that acted are those of the run's checkpoints, to the bit."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from otc_dist.deployment_log.reader import LogSummary
from otc_dist.description import Description
from otc_dist.run.folder import RunFolder
from otc_dist.spec import AgentSpec
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import JointStep

if TYPE_CHECKING:
    from otc_dist.learner.policy import Policy


@dataclass(frozen=True)
class Verdict:
    """Of one agent. `holds` is None where there is nothing to hold the log against."""

    agent: str
    holds: bool | None
    text: str


def check_policies(
    summary: LogSummary,
    description: Description,
    agents: Sequence[int],
    steps: Callable[[], Iterable[JointStep]],
) -> list[Verdict]:
    """Compare digests, and compute every logged action again from checkpoint and observation.

    Args:
        agents: places in the team of those to check.
        steps: gives the steps to compute again, once for every agent.
    """
    folder = RunFolder(summary.path.resolve().parent.parent)
    k = summary.header.deployment
    verdicts = []
    for index in agents:
        agent = summary.header.team.agents[index]
        path = folder.checkpoint(agent.name, k - 1)
        if not path.exists():
            verdicts.append(Verdict(agent.name, None, f"its checkpoint is not at {path}"))
            continue
        try:
            policy = _policy(description, agent, path)
        except UserError as error:
            verdicts.append(Verdict(agent.name, None, str(error)))
            continue
        verdicts.append(_check(summary, policy, index, steps()))
    return verdicts


def _policy(description: Description, agent: AgentSpec, path: Path) -> "Policy":
    """A checkpoint's policy, which acts where the run's did. Raises UserError."""
    import torch  # it takes seconds

    from otc_dist.learner.policy import Policy

    cuda = description.engine.name == "cuda-graph"
    if cuda and not torch.cuda.is_available():
        raise UserError("its actions were computed on a CUDA device, and there is none here")
    return Policy.of_checkpoint(path, description, agent, "cuda" if cuda else "cpu")


def _check(
    summary: LogSummary, policy: "Policy", index: int, steps: Iterable[JointStep]
) -> Verdict:
    name, digest = policy.spec.name, policy.digest
    recorded = summary.policies.get(name, digest)  # an unfinished log does not say
    if recorded != digest:
        return Verdict(name, False, f"policy {recorded} acted, but its checkpoint holds {digest}")
    computed = held = 0
    k, before = summary.header.deployment, None
    for step in steps:
        if step.held and step.held[index]:  # the first of a selection may continue one before it
            wrong = before is not None and before.tobytes() != step.actions[index].tobytes()
            what, held = "it holds another action than the one before", held + 1
        else:
            observations, exploring = step.observations[index], step.exploring[index]
            actions = policy.act_as(observations, "deployment", k, step.step, exploring=exploring)
            wrong = actions.tobytes() != step.actions[index].tobytes()
            what, computed = f"policy {digest} acts differently from the log", computed + 1
        if wrong:
            return Verdict(name, False, f"{what} in step {step.step:,}")
        before = step.actions[index]
    text = f"policy {digest}, actions of {computed:,} steps computed again"
    if held:
        text += f"; in {held:,} the one before was held"
    return Verdict(name, True, text)
