# SPDX-License-Identifier: Apache-2.0
"""What a simulation has in place of a person and of sensors: a force on the hand, and poses of objects."""

from __future__ import annotations

import time

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node

from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.session.arrangement import Arrangement
from tpgmm_workbench.session.leading import Leading

#: Objects are seen this often, s.
SIGHT_PERIOD = 1.0 / 30.0


class SimulatedWorld:
    """Leads the simulated hand by a spring, and publishes where the objects are as a camera would.

    Parameters
    ----------
    node
        publishes, and hears where the hand is
    task
        names the topics
    link
        the hand's link in the URDF
    arrangement
        where the objects lie

    Attributes
    ----------
    leading
        where the hand is led to
    """

    def __init__(self, node: Node, task: Task, link: str, arrangement: Arrangement) -> None:
        self.leading = Leading()
        self.arrangement = arrangement
        self._node, self._task, self._link = node, task, link
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self._places = {name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()}
        self._due = 0.0
        node.create_subscription(PoseStamped, task.movement, self._lead, STREAM)

    def _lead(self, message: PoseStamped) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        wrench = self.leading.wrench(1e-9 * stamp_ns, conversions.pose_to_array(message.pose))
        if wrench is not None:
            self._wrenches.publish(conversions.wrench_from_array(wrench, stamp_ns, self._link))

    def let_see(self) -> None:
        """Publish where the objects are, when it is time for it again."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = max(self._due + SIGHT_PERIOD, now)
        stamp_ns = self._node.get_clock().now().nanoseconds
        for name, pose in self.arrangement.in_sight().items():
            self._places[name].publish(conversions.pose_stamped(pose, stamp_ns, self._task.base_frame))
