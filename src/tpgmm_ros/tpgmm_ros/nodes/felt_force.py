# SPDX-License-Identifier: Apache-2.0
"""`FeltForce`: what a controller feels at the hand that it moves, so that the arm can yield to a person."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from tpgmm_core.control.supervised_controller import SupervisedController
from tpgmm_core.observation.external_torques import MeasuredForce
from tpgmm_core.observation.joint_states import JointSample
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages.joint_state_bytes import JointStateValues
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.nodes.hand_force import LASTS, WRENCH, HandForce

#: A force is judged this often, ns.
PERIOD_NS = SECOND // 50


class FeltForce:
    """See the module. It costs nothing while the controller does not yield.

    Parameters
    ----------
    node
        that receives wrenches
    robot
        whose dynamics measured torques are held against
    endpoint
        the hand
    controller
        that yields
    """

    def __init__(self, node: Node, robot: RobotModel, endpoint: str, controller: SupervisedController[Any]) -> None:
        self._node, self._controller = node, controller
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._measured, self._trouble, self._felt_ns = MeasuredForce(), "", 0
        self._wrench: WrenchStamped | None = None
        self._came_ns = 0
        self._last: JointSample | None = None
        self._force = HandForce(robot, endpoint)
        self._subscription: Subscription | None = None
        self.listen()

    def listen(self) -> None:
        """Listen to wrenches from now on, or no more: as the controller yields, or does not."""
        if self._is_wanted and self._subscription is None:
            self._subscription = self._node.create_subscription(WrenchStamped, WRENCH, self._take_wrench, STREAM)
        elif not self._is_wanted and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._wrench = None

    def take(self, message: JointStateValues, sample: JointSample | None) -> None:
        """Take in a message of joint states; `sample`: the state (positions first) that it completes."""
        self._last = sample or self._last
        if self._is_wanted and self._last is not None:
            self._force.take(message, self._last.values[0])

    def feel(self, now_ns: int) -> None:
        """Tell the controller, if it is time to; ns of the clock that watches."""
        if not self._is_wanted or 0 <= now_ns - self._felt_ns < PERIOD_NS:
            return
        self._felt_ns = now_ns
        if self._wrench is not None and self._steady.now().nanoseconds - self._came_ns > LASTS * SECOND:
            self._wrench = None
        self._measured = self._force.measured(self._wrench)
        self._trouble = self._controller.take_force(self._measured.newtons, now_ns)

    def values(self) -> dict[str, str]:
        """For diagnostics; nothing while the controller does not yield."""
        if not self._is_wanted:
            return {}
        measured = self._measured
        if measured.newtons is None:
            return {"hand_force": f"cannot be known: {measured.why or 'no joint states yet'}"}
        trouble = f"; {self._trouble}" if self._trouble else ""
        return {"hand_force": f"{measured.newtons:.1f} N, by {measured.source}{trouble}"}

    @property
    def _is_wanted(self) -> bool:
        return self._controller.guard.yielding.is_possible

    def _take_wrench(self, message: WrenchStamped) -> None:
        self._wrench, self._came_ns = message, self._steady.now().nanoseconds
