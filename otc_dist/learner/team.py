"""All agents' brains in one process: the same run as the services' without a bus.

For comparisons of many runs, for analysis, and for the tests that hold the distributed run
against it. Each brain still sees its own transitions only.
"""

from collections.abc import Sequence

import numpy as np

from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.learner.learner import Learner
from otc_dist.run.exploration import Schedule
from otc_dist.run.measured_returns import Measured, measure, team_rewards
from otc_dist.transitions import JointStep, Transitions


def deploy(learners: Sequence[Learner], deployment: int) -> list[JointStep]:
    """Deployment k = 1..K by the policies pi_{k-1}: all its joint steps."""
    description = learners[0].description
    progress = description.progress(deployment)
    env = registry.make(description.env.id, description.env.copies, progress)
    rollout = Rollout(env, description.seed, "deployment", deployment)
    steps = []
    schedule = Schedule.of(description, len(learners))
    for step in range(schedule.steps):
        exploring = schedule.exploring(step)
        actions = [
            learner.act(observations, "deployment", deployment, step, exploring=explores)
            for learner, observations, explores in zip(
                learners, rollout.observations, exploring, strict=True
            )
        ]
        steps.append(rollout.advance(actions, exploring))
    env.close()
    return steps


def own_transitions(steps: Sequence[JointStep], agent: int) -> Transitions:
    """What agent number `agent` keeps of a deployment: D_k in the order of (step, copy).

    Where one agent explored at a time, it keeps the steps in which it did so itself.
    """
    kept = [step for step in steps if step.exploring[agent] or not any(step.exploring)]
    return Transitions.concatenate([step.of_agent(agent) for step in kept])


def measured(steps: Sequence[JointStep], h: int) -> Measured:
    """What a deployment says of its policies, by the team's rewards; see `measured.measure`.

    Args:
        steps: all of one deployment, from its first.
        h: steps of an episode that count, the same at every deployment; see `measured.horizon`.

    Raises:
        UserError: too few episodes had room for h steps.
    """
    rewards = np.stack([team_rewards(step.rewards) for step in steps])
    terminated = np.stack([step.terminated for step in steps])
    truncated = np.stack([step.truncated for step in steps])
    return measure(rewards, terminated, truncated, h)


def evaluate(learners: Sequence[Learner], deployment: int) -> Rollout:
    """Play greedy episodes of the team pi_k; the rollout holds their returns."""
    description = learners[0].description
    progress, episodes = description.progress(deployment), description.evaluation.episodes
    copies = registry.affordable(description.env.id, episodes)
    env = registry.make(description.env.id, copies, progress)
    rollout = Rollout(env, description.seed, "evaluation", deployment, episodes)
    while not rollout.finished:
        actions = [
            learner.act(observations, "evaluation", deployment, rollout.step)
            for learner, observations in zip(learners, rollout.observations, strict=True)
        ]
        rollout.advance(actions, (False,) * len(learners))
    env.close()
    return rollout


def mean_return(rollout: Rollout) -> float:
    """Mean team return of a rollout's counted episodes."""
    return float(np.mean(rollout.episode_returns))
