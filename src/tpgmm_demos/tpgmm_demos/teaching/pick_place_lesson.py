# SPDX-License-Identifier: Apache-2.0
"""A scripted lesson in pick-and-place: one hand is led to the object, grasps it and brings it to its target."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node

from tpgmm_core.common.types import Array
from tpgmm_demos.scene.perception import SimulatedCamera
from tpgmm_demos.scene.pick_place import Grasp, Placement
from tpgmm_demos.teaching.teacher import Intention, Teacher, TeacherConfig
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task

#: The arm comes to rest before the teacher takes the hand, s.
SETTLE = 0.3


class ScriptedLesson:
    """One demonstration: the teacher's forces and the objects' poses, answered to each pose of the hand.

    The object is seen as long as it lies; in the hand it is hidden.
    """

    def __init__(
        self,
        node: Node,
        task: Task,
        link: str,
        situation: Placement,
        camera: SimulatedCamera,
        random: np.random.Generator,
    ) -> None:
        self.done = False
        self._node = node
        self._task = task
        self._link = link
        self._situation = situation
        self._camera = camera
        self._random = random
        self._grasp = Grasp(situation.object)
        self._start: float | None = None
        self._teacher: Teacher[Intention] | None = None
        self._stamp_ns = -1
        self._wrench = np.zeros(6)
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self._places = {name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()}
        self._subscription = node.create_subscription(PoseStamped, task.movement, self._answer, STREAM)
        self.duration = 0.0
        self.time = 0.0

    @property
    def failure(self) -> str:
        """What the teacher did not manage; empty if all went well."""
        return "" if self._grasp.holds else "the scripted teacher did not bring the hand to the object"

    def close(self) -> None:
        """Take its subscription and publishers away."""
        self._node.destroy_subscription(self._subscription)
        for publisher in (self._wrenches, *self._places.values()):
            self._node.destroy_publisher(publisher)

    def _answer(self, message: PoseStamped) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns > self._stamp_ns:
            self._stamp_ns = stamp_ns
            self._advance(1e-9 * stamp_ns, conversions.pose_to_array(message.pose))
        # The simulation waits for this; a pose that comes again did not get its answer.
        self._wrenches.publish(conversions.wrench_from_array(self._wrench, stamp_ns, self._link))

    def _advance(self, now: float, hand: Array) -> None:
        self._start = now if self._start is None else self._start
        self.time = now - self._start - SETTLE
        self._grasp.update(hand, now)
        places = {"target": self._situation.target}
        if not self._grasp.holds:
            places["object"] = self._grasp.object
        sighting = self._camera.look(self._stamp_ns, places)
        if sighting is not None:
            for name, pose in sighting.poses.items():
                message = conversions.pose_stamped(pose, sighting.stamp_ns, self._task.base_frame)
                self._places[name].publish(message)
        if self.time < 0.0 or self.done:
            return
        if self._teacher is None:
            config = TeacherConfig()
            self._teacher = Teacher(Intention(hand, self._situation, config, self._random), config)
            self.duration = self._teacher.intention.duration
        self._wrench = self._teacher.wrench(self.time, hand)
        self.done = self.time >= self.duration
