"""examples/ros2_robots.py against a stand-in of rclpy: what it promises to a clock."""

from collections.abc import Iterator

import numpy as np
import pytest

from otc_dist.description import user_code
from otc_dist.envs import registry
from otc_dist.terminal.errors import UserError

from .ros2_stand_in import Robot

ENV = "ros2_robots:parallel_env"


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    found = Robot()
    found.install(monkeypatch)
    monkeypatch.setattr(user_code, "_allowed", {ENV})
    yield found


def test_nothing_is_opened_before_the_first_reset_and_all_rests_after_close(robot: Robot) -> None:
    team = registry.team_spec(ENV)
    assert team.names == ("shoulder", "elbow") and team.agents[0].action_high == (0.5,)
    env = registry.make(ENV, 1)
    assert robot.calls == []
    env.reset(np.arange(1), np.arange(1))
    assert robot.calls[0] == "init {'signal_handler_options': 'no signals'}"
    outcome = env.step([np.full((1, 1), 0.25, np.float32), np.full((1, 1), 9.0, np.float32)])
    assert robot.told[-1] == [0.25, 0.5]  # clipped to what the joint can do
    own, other = env.observe()
    assert own[0].tolist() == pytest.approx([0.305, 0.25, -0.19, 0.5])
    assert other[0].tolist() == pytest.approx([-0.19, 0.5, 0.305, 0.25])
    assert outcome.rewards[0][0] == pytest.approx(-0.495)
    env.close()
    assert robot.told[-1] == [0.0, 0.0]
    calls = list(robot.calls)
    env.reset(np.arange(1), np.arange(1))  # another episode, by the same node
    assert robot.calls == calls


def test_a_robot_that_is_lost_is_one_line(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Robot, "publish", lambda self, message: self.told.append(message.data))
    monkeypatch.setattr("ros2_robots.DISCOVERY", 0.2)
    env = registry.make(ENV, 1)
    with pytest.raises(UserError, match=r"TimeoutError: nothing on /joint_states for 0.2 s"):
        env.reset(np.arange(1), np.arange(1))
    env.close()
    assert robot.told[-1] == [0.0, 0.0]
