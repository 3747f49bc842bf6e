"""Whether the policies that acted are those of the run's checkpoints, to the bit."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from otc_dist.deployment_log.reader import LogSummary
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.errors import UserError
from otc_dist.run_folder import RunFolder
from otc_dist.spec import AgentSpec
from otc_dist.stand_in import stand_in
from otc_dist.transitions import JointStep

if TYPE_CHECKING:
    from otc_dist.learner import Learner

_ROWS = 256  # of made-up data, with which a learner that only acts is content


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
            learner = _learner(description, agent, path)
        except UserError as error:
            verdicts.append(Verdict(agent.name, None, str(error)))
            continue
        verdicts.append(_check(summary, learner, index, steps()))
    return verdicts


def _learner(description: Description, agent: AgentSpec, path: Path) -> "Learner":
    """A learner with a checkpoint's policy. Raises UserError."""
    from otc_dist.learner import Learner  # with torch it takes seconds

    task = registry.task(description.env.id)
    learner = Learner(description, agent, stand_in(agent, _ROWS), task)
    learner.load(path)
    return learner


def _check(
    summary: LogSummary, learner: "Learner", index: int, steps: Iterable[JointStep]
) -> Verdict:
    name, digest = learner.spec.name, learner.policy_digest()
    recorded = summary.policies.get(name, digest)  # an unfinished log does not tell
    if recorded != digest:
        return Verdict(name, False, f"policy {recorded} acted, but its checkpoint holds {digest}")
    count, k = 0, summary.header.deployment
    for step in steps:
        observations, exploring = step.observations[index], step.exploring[index]
        actions = learner.act(observations, "deployment", k, step.step, exploring=exploring)
        if actions.tobytes() != step.actions[index].tobytes():
            text = f"policy {digest} acts otherwise than was logged in step {step.step:,}"
            return Verdict(name, False, text)
        count += 1
    return Verdict(name, True, f"policy {digest}, actions of {count:,} steps computed again")
