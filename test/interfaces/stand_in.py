# SPDX-License-Identifier: Apache-2.0
"""What robots as processes of their own share: joint states out, what breaks their contract, what they were told."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import EVENTS

KEPT = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: How often it says what it was told, s.
REPORT_PERIOD = 0.2
#: Of /clock, s of the time that it says; and when that begins.
CLOCK_PERIOD, BEGIN_NS = 0.002, 1_000_000_000_000


class StandIn(Node):
    """A robot whose joints are published in another order, as drivers do.

    `violations` (std_msgs/String) has one message for each break of the contract; `robot_report` (the same) the number
    of commands and the longest time between two of them while the robot was told to move, as JSON. `slower` than real
    time, it publishes the simulated time on /clock: for machines that are busy, or slow.
    """

    def __init__(self, name: str, robot: RobotModel, joints: Sequence[str], slower: float = 0.0) -> None:
        super().__init__(name)
        self.robot, self.order = robot, list(joints)
        self._slower, self._begun_ns = slower, time.monotonic_ns()
        if slower:
            self._clock_publisher = self.create_publisher(Clock, "/clock", EVENTS)
            self.create_timer(slower * CLOCK_PERIOD, self._tick)
        self.commands, self.longest_gap = 0, 0.0
        self._told_ns: int | None = None
        self._states = self.create_publisher(JointState, "joint_states", 10)
        self._violations = self.create_publisher(String, "violations", KEPT)
        self._report = self.create_publisher(String, "robot_report", KEPT)
        self.create_timer(REPORT_PERIOD, self._say)

    def now_ns(self) -> int:
        """Its time, ns."""
        if not self._slower:
            return self.get_clock().now().nanoseconds
        return BEGIN_NS + round((time.monotonic_ns() - self._begun_ns) / self._slower)

    def now(self) -> float:
        """The same in s."""
        return 1e-9 * self.now_ns()

    def every(self, period: float, step: Callable[[], None]) -> None:
        """Call a function regularly, each `period` s of its time."""
        self.create_timer(period * (self._slower or 1.0), step)

    def _tick(self) -> None:
        self._clock_publisher.publish(Clock(clock=conversions.time_from_ns(self.now_ns())))

    def violate(self, *texts: str) -> None:
        """Say what broke the contract."""
        for text in texts:
            self._violations.publish(String(data=text))

    def hear(self, moves: bool) -> None:
        """Count a command, which tells the robot to move, or to stay."""
        now_ns = self.now_ns()
        if self._told_ns is not None:
            self.longest_gap = max(self.longest_gap, 1e-9 * (now_ns - self._told_ns))
        self._told_ns = now_ns if moves else None
        self.commands += 1

    def publish_state(self, q: Array, v: Array) -> None:
        """Positions and velocities (n,) of its joints now."""
        message = JointState(name=self.order[::-1], position=q[::-1].tolist(), velocity=v[::-1].tolist())
        message.header.stamp = conversions.time_from_ns(self.now_ns())
        self._states.publish(message)

    def _say(self) -> None:
        report = {"commands": self.commands, "longest_gap_s": self.longest_gap}
        self._report.publish(String(data=json.dumps(report)))


def slower(words: list[str]) -> float:
    """Take `--slower=N` off the words of a command line; N, or 0 where it is not there."""
    given = [word for word in words if word.startswith("--slower=")]
    for word in given:
        words.remove(word)
    return float(given[0].partition("=")[2]) if given else 0.0


def run(node: StandIn) -> None:
    """Until a signal ends it."""
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
