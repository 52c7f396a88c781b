# SPDX-License-Identifier: Apache-2.0
"""What tests of joint_motion share: a UR5 that takes positions, and references that a reproduction would send."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from ros_graph import ALL_LATCHED, ROOT, Diagnostics, Inbox
from ros_testing import RunningProcess, spin_until
from tpgmm_core import Gaussian
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED, STREAM

NODE = "joint_motion"
UR5_FILE = ROOT / "config" / "ur5.yaml"
UR5 = RobotModel.from_file(UR5_FILE)
ARM = list(UR5.joint_groups["arm"])
RELIABLE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
COVARIANCE = np.diag([1e-6] * 3 + [1e-4] * 3)


def hand(q: np.ndarray) -> np.ndarray:
    """Pose (7,) of the flange."""
    data = UR5.create_data()
    data.update(q)
    return data.pose("tool")


@dataclass
class Bench:
    """A robot, and the program under test; `seek` plays the reproduction."""

    node: Node
    processes: tuple[RunningProcess, ...]
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    references: bool = True
    covariance: np.ndarray = field(default_factory=lambda: COVARIANCE)

    def __post_init__(self) -> None:
        self.states = Inbox(self.node, ControllerState, "controller_state", ALL_LATCHED)
        self.violations = Inbox(self.node, String, "violations", ALL_LATCHED)
        self.sent = Inbox(self.node, JointTrajectory, "joint_trajectory_controller/joint_trajectory", RELIABLE)
        self.diagnostics = Diagnostics(self.node)
        self.q = UR5.home.copy()
        self._publisher = self.node.create_publisher(ReferenceMessage, "reference", STREAM)
        self._mode = self.node.create_publisher(String, "robot_mode", LATCHED)
        self.node.create_subscription(JointState, "joint_states", self._answer, STREAM)
        self.node.create_timer(0.02, self._refer)
        self.stamp_ns = 0

    def _answer(self, state: JointState) -> None:
        self.stamp_ns = conversions.time_to_ns(state.header.stamp)
        self.q = UR5.ordered(list(state.name), state.position)

    def _refer(self) -> None:
        """As a reproduction, which answers joint states; also where these have stopped."""
        if not self.references:
            return
        mean = hand(UR5.home) + np.array([*self.offset, 0, 0, 0, 0])
        reference = Reference(0.5, Gaussian(mean, self.covariance, POSE), 0.0, (), np.ones(1), ())
        now_ns = self.node.get_clock().now().nanoseconds
        self._publisher.publish(conversions.reference_message(reference, [], now_ns, "base_link"))

    def mode(self, mode: str) -> None:
        self._mode.publish(String(data=mode))

    def until(self, condition: Callable[[], Any], message: str, timeout: float = 30.0) -> None:
        spin_until(self.node, condition, timeout, message, self.processes)

    def until_it_says(self, mode: ControllerMode, words: str) -> None:
        def said() -> bool:
            last = self.states.last
            return last is not None and last.state == mode and words in last.reason

        try:
            self.until(said, f"{mode.name}: {words}")
        except AssertionError as error:
            raise AssertionError(
                f"{error}; it said {[(m.state, m.reason) for m in self.states.messages[-8:]]}"
            ) from None

    @property
    def missing(self) -> float:
        return float(np.linalg.norm(hand(self.q)[:3] - hand(UR5.home)[:3] - self.offset))

    def forgets(self) -> None:
        self.states.clear()
        self.sent.clear()

    @staticmethod
    def is_jump_to(violation: String, q: np.ndarray) -> bool:
        """Whether the robot saw a jump of what it is told, to these joints."""
        words, _, place = violation.data.rpartition(" to ")
        return words.startswith("jump: ") and bool(np.abs(np.array(json.loads(place)) - q).max() < 1e-3)
