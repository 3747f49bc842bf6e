"""Sequential exploration: whose turn it is, whose data they are, and what an explorer does."""

import numpy as np

from otc_dist.description import DeploymentSection, Description
from otc_dist.run.exploration import Schedule, explore


def schedule(*assignments: str) -> Schedule:
    data: dict[str, object] = {
        "name": "x",
        "env": {"id": "hopper-3x1", "copies": 4},
        "dataset": {"name": "random"},
        "deployment": {"transitions": 20},
    }
    return Schedule.of(Description.build(data, assignments), agents=3)


def test_nobody_explores_by_default_and_everybody_keeps_everything() -> None:
    plain = schedule()
    assert plain.steps == 5
    assert all(plain.exploring(step) == (False,) * 3 for step in range(5))
    assert all(plain.own(agent) == range(5) for agent in range(3))


def test_each_agent_explores_in_a_turn_of_its_own_and_keeps_that() -> None:
    sequential = schedule("deployment.exploration=sequential")
    assert sequential.steps == 15
    turns = [sequential.exploring(step).index(True) for step in range(15)]
    assert turns == [0] * 5 + [1] * 5 + [2] * 5
    for agent in range(3):
        assert [step for step in range(15) if turns[step] == agent] == list(sequential.own(agent))


def test_an_explorer_adds_noise_within_bounds() -> None:
    actions = np.linspace(-1, 1, 4000, dtype=np.float32).reshape(2000, 2)
    settings = DeploymentSection(exploration_noise=0.2)
    found = explore(actions, actions, 0, settings, np.random.default_rng(0))
    assert found.dtype == np.float32 and np.abs(found).max() <= 1
    inside = np.abs(actions) < 0.2
    np.testing.assert_allclose(np.std((found - actions)[inside]), 0.2, rtol=0.1)


def test_an_explorer_takes_some_of_the_available_actions() -> None:
    masks = np.tile(np.array([0, 1, 0, 1, 1], np.float32), (6000, 1))
    greedy = np.full((6000, 1), 3, np.float32)
    settings = DeploymentSection(exploration_rate=0.3)
    found = explore(greedy, masks, 5, settings, np.random.default_rng(0))
    counts = np.bincount(found[:, 0].astype(int), minlength=5) / 6000
    np.testing.assert_allclose(counts, [0, 0.1, 0, 0.8, 0.1], atol=0.02)
