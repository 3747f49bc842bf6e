"""Data that the updates are compiled with: such as the learners will accept."""

import pytest

from otc_dist.envs import registry
from otc_dist.launch.run.compile import made_up
from otc_dist.transitions import RowLayout


@pytest.mark.parametrize("env_id", ["halfcheetah-2x3", "5m_vs_6m"])
def test_made_up_data_fit_the_agent(env_id: str) -> None:
    agent = registry.team_spec(env_id).agents[1]
    layout = RowLayout(agent.observation_size, agent.action_size, agent.choices)
    assert layout.pack(made_up(agent, 50)).shape == (50, layout.width)
