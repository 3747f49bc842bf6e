"""All brains in one process: deployments and evaluations of a team."""

import numpy as np
import pytest

from otc_dist.envs import registry
from otc_dist.envs.rollout import Rollout
from otc_dist.learner import team
from otc_dist.learner.learner import Learner

from ..brains import ARMS, describe, pretrained, transitions


@pytest.fixture(scope="module")
def learners() -> list[Learner]:
    tiny = (
        *ARMS["uniform"],
        "offline.updates=5",
        "evaluation.episodes=2",
        "algorithm={name='bcq',acting_candidates=3}",
    )
    return [
        pretrained(*tiny, spec=spec, data=transitions(i, 100, spec))
        for i, spec in enumerate(registry.team_spec("hopper-3x1").agents)
    ]


def test_a_deployment_has_m_transitions_and_each_agent_its_own(learners: list[Learner]) -> None:
    steps = team.deploy(learners, 1)
    assert describe().env.copies == 4 and len(steps) == 10  # M = 40
    parts = [team.own_transitions(steps, agent) for agent in range(3)]
    for agent, own in enumerate(parts):
        assert len(own) == 40 and own.actions.shape == (40, 1)
        for t, step in enumerate(steps):
            rows = slice(4 * t, 4 * t + 4)
            assert np.array_equal(own.actions[rows], step.actions[agent])
            assert np.array_equal(own.next_observations[rows], step.next_observations[agent])
    assert not np.array_equal(parts[0].actions, parts[1].actions)


def test_a_deployment_is_a_function_of_the_policies_and_its_number(
    learners: list[Learner],
) -> None:
    first, again, other = (team.own_transitions(team.deploy(learners, k), 0) for k in (1, 1, 2))
    assert first.actions.tobytes() == again.actions.tobytes()
    assert first.next_observations.tobytes() == again.next_observations.tobytes()
    assert first.actions.tobytes() != other.actions.tobytes()


def test_an_evaluation_counts_one_episode_a_copy(learners: list[Learner]) -> None:
    rollout = team.evaluate(learners, 0)
    assert rollout.finished and len(rollout.episode_returns) == 2
    assert team.mean_return(rollout) == pytest.approx(np.mean(rollout.episode_returns))


def test_an_evaluation_is_what_the_env_host_would_play(learners: list[Learner]) -> None:
    env = registry.make("hopper-3x1", 2)
    rollout = Rollout(env, 0, "evaluation", 1)
    while not rollout.finished:
        actions = [
            learner.act(observations, "evaluation", 1, rollout.step)
            for learner, observations in zip(learners, rollout.observations, strict=True)
        ]
        rollout.advance(actions, (False,) * 3)
    assert team.evaluate(learners, 1).episode_returns == rollout.episode_returns


def test_a_deployment_measures_its_policies_by_the_teams_rewards(learners: list[Learner]) -> None:
    steps = team.deploy(learners, 1)
    found = team.measured(steps, 5)
    first = [sum(float(step.rewards[0][copy]) for step in steps[:5]) for copy in range(4)]
    assert found.episodes >= 4  # of robots that stand for five steps: the first of every copy
    if found.episodes == 4:
        assert found.mean == pytest.approx(np.mean(first))
