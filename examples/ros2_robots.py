"""Two joints of a ROS 2 graph, an agent each: the environment of docs/robots.md, not run by us.

    python -m otc_dist.launch navigation --set env.id=ros2_robots:parallel_env ...

Written for rclpy as of Humble. rclpy does not come from PyPI, so this has been run against a
stand-in alone (tests/envs/test_ros2_example.py). Topics, joints, reward and limits are yours.
"""

import threading
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

JOINTS = ("shoulder", "elbow")  # as in JointState.name; agents are called by them
STATES, COMMANDS = "/joint_states", "/velocity_controller/commands"
FASTEST = 0.5  # rad/s
SILENCE = 0.5  # seconds without a state, after which the robot counts as lost
DISCOVERY = 10.0  # seconds that it may take to find the robot first

Numbers = NDArray[np.float32]


class Graph:
    """This process's node: the newest state of the joints, and their commands.

    Only the env host makes one, so only its machine needs ROS 2.
    """

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.qos import qos_profile_sensor_data
        from rclpy.signals import SignalHandlerOptions
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        # Signals stay those of the env host, which ends a deployment in order by them.
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self._message = Float64MultiArray
        self._news = threading.Condition()
        self._state: Numbers | None = None  # the newest, until it is taken
        self._node = Node("otc_dist")
        self._node.create_subscription(JointState, STATES, self._hear, qos_profile_sensor_data)
        self._commands = self._node.create_publisher(Float64MultiArray, COMMANDS, 1)
        executor = SingleThreadedExecutor()
        executor.add_node(self._node)
        threading.Thread(target=executor.spin, name="ros2", daemon=True).start()

    def _hear(self, message: Any) -> None:
        places = [list(message.name).index(joint) for joint in JOINTS]
        rows = [[message.position[place], message.velocity[place]] for place in places]
        with self._news:
            self._state = np.array(rows, np.float32)
            self._news.notify_all()

    def state(self, timeout: float = SILENCE) -> Numbers:
        """The newest state that was not given yet, (2, position and velocity)."""
        with self._news:
            if not self._news.wait_for(lambda: self._state is not None, timeout):
                raise TimeoutError(f"nothing on {STATES} for {timeout:g} s")
            state, self._state = self._state, None
        assert state is not None
        return state

    def command(self, speeds: Numbers) -> None:
        self._commands.publish(self._message(data=[float(speed) for speed in speeds]))

    def rest(self) -> None:
        """Stop both joints."""
        self.command(np.zeros(len(JOINTS), np.float32))


class Arm(ParallelEnv):  # type: ignore[misc]  # PettingZoo is untyped
    """Both joints are to come to zero, and get one reward."""

    metadata: ClassVar = {"name": "arm"}
    max_cycles = 500

    def __init__(self) -> None:
        self.possible_agents = list(JOINTS)
        self._graph: Graph | None = None  # from the first reset on

    def observation_space(self, agent: str) -> Box:
        """Its own position and velocity, then the other's."""
        return Box(-np.inf, np.inf, (4,), np.float32)

    def action_space(self, agent: str) -> Box:
        """Its velocity, rad/s."""
        return Box(-FASTEST, FASTEST, (1,), np.float32)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Numbers], dict[str, dict[str, Any]]]:
        """A person has put the arm where it begins (deployment.reset_by_hand)."""
        self.agents, self._steps = list(JOINTS), 0
        if self._graph is None:
            self._graph = Graph()
        self._graph.rest()
        return self._seen(self._graph.state(DISCOVERY)), {joint: {} for joint in JOINTS}

    def _seen(self, state: Numbers) -> dict[str, Numbers]:
        rows = {joint: np.roll(state, -place, axis=0) for place, joint in enumerate(JOINTS)}
        return {joint: row.reshape(-1) for joint, row in rows.items()}

    def step(
        self, actions: Mapping[str, Numbers]
    ) -> tuple[
        dict[str, Numbers],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Send the commands at once; return with the next state."""
        assert self._graph is not None, "reset comes first"
        self._graph.command(np.concatenate([actions[joint] for joint in JOINTS]))
        state = self._graph.state()
        self._steps += 1
        reward = -float(np.abs(state[:, 0]).sum())
        return (
            self._seen(state),
            dict.fromkeys(JOINTS, reward),
            dict.fromkeys(JOINTS, False),
            dict.fromkeys(JOINTS, self._steps >= self.max_cycles),
            {joint: {} for joint in JOINTS},
        )

    def close(self) -> None:
        """The joints rest. The node stays, to be found again at once, as long as the process."""
        if self._graph is not None:
            self._graph.rest()


def parallel_env() -> Arm:
    """`env.id=ros2_robots:parallel_env`."""
    return Arm()
