# SPDX-License-Identifier: Apache-2.0
"""baxter_simulator alone, in real time, and whoever commands it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ALL, ROBOT_FILE, Inbox, ros_arguments
from ros_testing import StartProcess, spin_until
from simulated_hand import NAMES, ROBOT
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import STREAM

ELBOW = NAMES.index("left_e1")
#: The joint is pushed with this torque beyond what carries the robot, N m.
PUSH = -3.0
#: A robot whose joints are all slower is at rest, rad/s.
AT_REST = 0.02


class RobotBench:
    """A simulated robot, and publishers of torques and wrenches."""

    name: ClassVar[str] = "robot"
    realtime: ClassVar[bool] = False

    def __init__(self, node: Node, start: StartProcess) -> None:
        self.node = node
        self.process = start("baxter_simulator", *ros_arguments(robot_file=ROBOT_FILE, rate=500.0))
        self.states = Inbox(node, JointState, "joint_states", ALL)
        self.torques = node.create_publisher(JointState, "joint_torques", STREAM)
        self.wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self._reader = JointReader(NAMES)
        self._data = ROBOT.create_data()

    @classmethod
    def open(cls, node: Node, start: StartProcess, directory: Path) -> Self:
        return cls(node, start)

    def wait(self, condition: Callable[[], Any], what: str) -> float:
        """Serve the topics until a condition holds; how long that took, s."""
        began = time.monotonic()
        spin_until(self.node, condition, message=what, processes=(self.process,))
        return time.monotonic() - began

    def prepare(self) -> None:
        self.wait(lambda: self.states.messages and self.torques.get_subscription_count() == 1, "the robot to be there")
        self.wait(lambda: self.speed() < AT_REST, "rest")
        self.states.clear()
        self.wait(lambda: self.states.messages, "joint states")

    def settle(self) -> str:
        speed = self.drive()
        rest = self.wait(lambda: self.speed() < AT_REST, "rest")
        return f"back: driven by torques to {speed:.2f} rad/s, at rest {rest:.2f} s after the last one"

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        q, v = self._reader.read(self.states.last, "position", "velocity")
        return q, v

    def speed(self) -> float:
        """The fastest joint, rad/s."""
        return float(np.abs(self.state()[1]).max())

    def weight(self) -> np.ndarray:
        """Torques (nv,) that carry the robot where it is, N m."""
        return self._data.nonlinear_effects(*self.state()).copy()

    def command(self, effort: np.ndarray, names: list[str] = NAMES) -> None:
        stamp_ns = conversions.time_to_ns(self.states.last.header.stamp)
        self.torques.publish(conversions.joint_state_message(names, stamp_ns, effort=effort))

    def drive(self) -> float:
        """Push the elbow until it moves; its speed, rad/s."""

        def moves() -> bool:
            tau = self.weight()
            tau[ELBOW] += PUSH
            self.command(tau)
            return bool(self.state()[1][ELBOW] < -0.2)

        self.wait(moves, "the elbow to move")
        return abs(float(self.state()[1][ELBOW]))

    def applied(self) -> np.ndarray:
        """The torques (T, nv) that moved the robot, N m."""
        return np.array([self._reader.read(message, "effort")[0] for message in self.states.messages])
