# SPDX-License-Identifier: Apache-2.0
"""What a simulation has in place of a person and of sensors: where its hand is led, and poses of objects."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from tpgmm_core.common.types import Array
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.session.arrangement import Arrangement

#: Objects are seen, and the hand is led, this often, s; a hand that is let go of is told so this many times.
PERIOD, TOLD = 1.0 / 30.0, 10

#: The hand's pose (7,) in its own frame.
NOWHERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class SimulatedWorld:
    """Says to the simulator where to lead the hand, and publishes where the objects are as a camera would.

    Parameters
    ----------
    node
        publishes
    task
        names the topics
    arrangement
        where the objects lie
    hand
        frame of the hand

    Attributes
    ----------
    aim
        (7,) where the hand is led to; None while nobody leads it
    """

    def __init__(self, node: Node, task: Task, arrangement: Arrangement, hand: str) -> None:
        self.aim: Array | None = None
        self.arrangement = arrangement
        self._node, self._base, self._hand, self._to_tell = node, task.base_frame, hand, 0
        self._lead = node.create_publisher(PoseStamped, f"lead/{task.endpoint}/pose", STREAM)
        self._places = {name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()}
        self._told_ns = -1
        # a camera of its own: a page that is slow must not make the objects look hidden
        node.create_timer(PERIOD, self._tell, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _tell(self) -> None:
        """Publish where the objects are, and where the hand is to be."""
        stamp_ns = self._node.get_clock().now().nanoseconds
        if stamp_ns == self._told_ns:  # a simulation that stands still: nothing new is seen
            return
        self._told_ns = stamp_ns
        for name, pose in self.arrangement.in_sight().items():
            self._places[name].publish(conversions.pose_stamped(pose, stamp_ns, self._base))
        if self.aim is not None:
            self._to_tell = TOLD
            self._lead.publish(conversions.pose_stamped(self.aim, stamp_ns, self._base))
        elif self._to_tell:  # at once, and not when the simulator has not heard of it for a while
            self._to_tell -= 1
            self._lead.publish(conversions.pose_stamped(NOWHERE, stamp_ns, self._hand))
