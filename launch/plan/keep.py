"""What a run keeps, settled before anything runs: whether its deployments can be compared."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from otc_dist.datasets import store
from otc_dist.description import Description
from otc_dist.envs import registry
from otc_dist.run import measured_returns
from otc_dist.run.exploration import Schedule
from otc_dist.terminal.errors import UserError
from otc_dist.transitions import Float32


def settled(description: Description) -> Description:
    """A copy of a description, otherwise resolved, with deployment.keep fixed.

    Unset, it is "best" where that is sure to work: all agents get one reward, nobody explores,
    every deployment is of one environment, and holds enough episodes whatever the policies do.

    Raises:
        UserError: "best", the floor or revert is asked for and cannot work.
    """
    env, deployment = description.env, description.deployment
    team = registry.team_spec(env.id)
    schedule = Schedule.of(description, len(team.agents))
    if deployment.keep == "best" or deployment.floor is not None:
        asked = "deployment.keep = 'best'" if deployment.keep == "best" else "deployment.floor"
        if not measured_returns.possible(schedule.steps, env.copies):
            raise UserError(
                f"{asked} needs {measured_returns.ENOUGH} episodes of a deployment, and one of"
                f" {deployment.transitions} transitions in {env.copies} copy holds fewer: deploy"
                " longer (deployment.transitions), or in more copies (env.copies)"
            )
    if deployment.keep is not None:
        return description
    certain = measured_returns.certain(schedule.steps, env.copies, team.max_episode_steps)
    doubts = {
        "agents explore": schedule.sequential,
        "the environment changes from one deployment to the next": registry.changes(env.id),
        "agents may get different rewards": not registry.shares_reward(env.id),
        "a deployment may hold too few episodes": not certain,
    }
    doubt = next((why for why, holds in doubts.items() if holds), None)
    if doubt and deployment.revert:
        raise UserError(
            "deployment.revert needs deployment.keep = 'best', which is not chosen here, as"
            f" {doubt}: set deployment.revert=false, or deployment.keep=best if you know better"
        )
    return description.with_assignments(f"deployment.keep={'last' if doubt else 'best'}")


def check_rewards(description: Description, agents: Sequence[str]) -> None:
    """Refuse to keep the best where the agents' data say already that their rewards differ.

    Where the environment is sure to give all agents the same, no file is opened.

    Raises:
        UserError: they do; or a file cannot be read.
    """
    dataset = description.dataset
    if description.deployment.keep != "best" or registry.shares_reward(description.env.id):
        return

    def rewards(agent: str) -> Float32:
        path: Path = store.agent_file(dataset.name, agent, dataset.transitions)
        return store.load_agent(path, agent).rewards

    first = rewards(agents[0])
    for agent in agents[1:]:
        if not np.array_equal(first, rewards(agent)):
            raise UserError(
                f"deployment.keep = 'best' needs one reward for all agents, and in {dataset.name}"
                f" {agents[0]} and {agent} got different ones: set {measured_returns.WITHOUT}"
            )
