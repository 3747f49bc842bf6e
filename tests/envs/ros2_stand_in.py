"""What examples/ros2_robots.py uses of ROS 2, in one thread: rclpy cannot be installed here.

A robot of two joints answers each command with its next state, and says nothing otherwise.
"""

import sys
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest


class Robot:
    """The graph beyond our node; `calls` are what was done with rclpy, in order."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.told: list[list[float]] = []
        self._positions = [0.3, -0.2]
        self._hear: Callable[[Any], None] | None = None

    def publish(self, message: Any) -> None:
        self.told.append(message.data)
        self._positions = [x + v / 50 for x, v in zip(self._positions, message.data, strict=True)]
        self.say(message.data)
        self.say(message.data)  # more often than it is asked

    def say(self, speeds: list[float]) -> None:
        """Its state, in the other order than the agents'."""
        assert self._hear is not None
        names, positions = ["elbow", "shoulder"], self._positions[::-1]
        self._hear(SimpleNamespace(name=names, position=positions, velocity=speeds[::-1]))

    def install(self, patch: pytest.MonkeyPatch) -> None:
        """Let `import rclpy` find this robot."""
        robot = self

        class Node:
            def __init__(self, name: str) -> None:
                robot.calls.append(f"node {name}")

            def create_subscription(self, kind: Any, topic: str, hear: Any, qos: Any) -> None:
                robot.calls.append(f"hears {topic}")
                robot._hear = hear

            def create_publisher(self, kind: Any, topic: str, depth: int) -> Robot:
                robot.calls.append(f"tells {topic}")
                return robot

        class Executor:
            def add_node(self, node: Node) -> None:
                robot.calls.append("spins")

            def spin(self) -> None:
                pass  # who publishes hears at once

        contents: dict[str, dict[str, Any]] = {
            "rclpy": {"init": lambda **how: robot.calls.append(f"init {how}")},
            "rclpy.executors": {"SingleThreadedExecutor": Executor},
            "rclpy.node": {"Node": Node},
            "rclpy.qos": {"qos_profile_sensor_data": None},
            "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="no signals")},
            "sensor_msgs": {},
            "sensor_msgs.msg": {"JointState": SimpleNamespace},
            "std_msgs": {},
            "std_msgs.msg": {"Float64MultiArray": SimpleNamespace},
        }
        for name, content in contents.items():
            module = ModuleType(name)
            vars(module).update(content)
            patch.setitem(sys.modules, name, module)
