# SPDX-License-Identifier: Apache-2.0
"""A robot in real time whose joint states come late, through a relay in a process of its own; and its controller."""

from __future__ import annotations

import contextlib
import itertools
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ros_graph import (
    ACTIVATE,
    ALL,
    ALL_LATCHED,
    CONFIGURE,
    DEACTIVATE,
    ROBOT_FILE,
    Diagnostics,
    Inbox,
    change_state,
    ros_arguments,
    set_parameters,
)
from ros_testing import StartProcess, spin_until
from simulated_hand import ROBOT, pose_reference
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import LATCHED, STREAM

NODE = "impedance_controller"
RATE = 500.0
LATE = "late/joint_states"
#: References, s apart.
PERIOD = 0.01
#: Of the demonstrations that the references stand for, m: as firm as `max_stiffness` permits, and softer.
FIRM, SOFT = 0.002, 0.02
#: Where the hand is sent, m.
AWAY = np.array([0.0, 0.06, 0.04, 0.0, 0.0, 0.0, 0.0])
#: Shares of the speed limits: without delay a joint has some 0.75 on the way `AWAY`; slower than the second is rest.
ORDINARY, AT_REST = 0.95, 0.03


class LateBench:
    """What the joints really do is in `joint_states`; the controller reads `late/joint_states`."""

    name: ClassVar[str] = "late"
    realtime: ClassVar[bool] = True

    def __init__(self, node: Node, start: StartProcess) -> None:
        self.node = node
        self.simulator = start(
            "baxter_simulator", *ros_arguments(robot_file=ROBOT_FILE, rate=RATE, realtime_priority=20)
        )
        arguments = ros_arguments(
            robot_file=ROBOT_FILE, joint_state_rate=RATE, realtime_priority=20, joint_state_timeout=0.25, hold_time=0.3
        )
        self.process = start(NODE, *arguments, "-r", f"joint_states:={LATE}")
        script = Path(__file__).with_name("late_relay.py")
        self.relay = start(sys.executable, str(script), "joint_states", LATE)
        self._processes = (self.simulator, self.process, self.relay)
        self.states = Inbox(node, JointState, "joint_states", ALL)
        self.torques = Inbox(node, JointState, "joint_torques", ALL)
        self.modes = Inbox(node, ControllerState, "controller_state", ALL_LATCHED)
        self.poses = Inbox(node, PoseStamped, "endpoint/left/pose", ALL)
        self.diagnostics = Diagnostics(node)
        self._delay = node.create_publisher(Float64MultiArray, "delay", LATCHED)
        self._references = node.create_publisher(ReferenceMessage, "reference", STREAM)
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self._reader = JointReader(list(ROBOT.joint_names))
        self.goal: np.ndarray | None = None
        self.deviation = FIRM
        node.create_timer(PERIOD, self._refer)
        assert change_state(node, NODE, CONFIGURE)

    @classmethod
    def open(cls, node: Node, start: StartProcess, directory: Path) -> Self:
        return cls(node, start)

    def prepare(self) -> None:
        self.delay(0.0)
        assert set_parameters(self.node, NODE, max_age=0.2).successful
        self.states.clear()
        self.poses.clear()
        self.wait(lambda: len(self.states.messages) > 100 and self.poses.messages, "the robot to be there")
        assert change_state(self.node, NODE, ACTIVATE)
        self.goal, self.deviation = self.pose(), SOFT
        self.wait(lambda: self.is_in(ControllerState.ACTIVE), "the controller to follow")
        self.spin_for(1.0)
        self.clear()

    def settle(self) -> str:
        """Without delay it follows again, by itself."""
        self.delay(0.0)
        self.goal, self.deviation = self.pose(), SOFT
        back = self.wait(lambda: self.is_in(ControllerState.ACTIVE), "the controller to follow again")
        self.goal = None
        assert change_state(self.node, NODE, DEACTIVATE)
        self.wait(lambda: self.speed() < AT_REST, "rest")
        return f"back by itself within {back:.1f} s"

    def delay(self, late: float, varies: float = 0.0) -> None:
        """How late joint states are from now on, s."""
        self._delay.publish(Float64MultiArray(data=[late, varies]))

    @contextlib.contextmanager
    def ages(self) -> Iterator[list[float]]:
        """How old the controller's joint states are, s, as this process sees it."""
        seen: list[float] = []

        def take(message: JointState) -> None:
            age_ns = self.node.get_clock().now().nanoseconds - conversions.time_to_ns(message.header.stamp)
            seen.append(1e-9 * age_ns)

        subscription = self.node.create_subscription(JointState, LATE, take, ALL)
        try:
            yield seen
        finally:
            self.node.destroy_subscription(subscription)

    def push(self, force: np.ndarray) -> None:
        """A force (3,) at the hand, N, for 0.2 s unless it is repeated."""
        self._wrenches.publish(conversions.wrench_from_array([*force, 0.0, 0.0, 0.0], 0, "left_gripper"))

    def clear(self) -> None:
        """Forget what has been said so far."""
        for inbox in (self.states, self.torques, self.modes):
            inbox.clear()

    def wait(self, condition: Callable[[], object], what: str) -> float:
        """Serve the topics until a condition holds; how long that took, s."""
        began = time.monotonic()
        spin_until(self.node, condition, message=what, processes=self._processes)
        return time.monotonic() - began

    def spin_for(self, seconds: float, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Let time pass; `meanwhile` is done all the time."""
        end = time.monotonic() + seconds

        def over() -> bool:
            meanwhile()
            return time.monotonic() > end

        self.wait(over, "time to pass")

    def pose(self) -> np.ndarray:
        """Of the hand, (7,)."""
        return conversions.pose_to_array(self.poses.last.pose)

    def is_in(self, mode: int, reason: str = "") -> bool:
        """Whether the controller says so now."""
        told = self.modes.last
        return told is not None and told.state == mode and reason in told.reason

    def said(self) -> list[str]:
        """The modes one after the other, each change once."""
        return [ControllerMode(mode).name for mode, _ in itertools.groupby(item.state for item in self.modes.messages)]

    def speeds(self) -> np.ndarray:
        """Of all joints (T, nv), as shares of their limits."""
        read = [self._reader.read(message, "velocity")[0] for message in self.states.messages]
        return np.abs(np.array(read).reshape(-1, ROBOT.nv)) / ROBOT.velocity_limits

    def speed(self) -> float:
        """The fastest joint of the last 0.1 s, as a share of its limit."""
        return float(self.speeds()[-round(0.1 * RATE) :].max())

    def torque(self) -> float:
        """The largest torque that was sent, as a share of its limit."""
        read = [self._reader.read(message, "effort")[0] for message in self.torques.messages]
        return float((np.abs(np.array(read)) / ROBOT.effort_limits).max())

    def away(self) -> float:
        """Of the hand from its goal, m."""
        assert self.goal is not None
        return float(np.linalg.norm(self.pose()[:3] - self.goal[:3]))

    def _refer(self) -> None:
        if self.goal is not None:
            stamp_ns = self.node.get_clock().now().nanoseconds
            self._references.publish(pose_reference(self.goal, stamp_ns, self.deviation))
