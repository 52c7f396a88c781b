# SPDX-License-Identifier: Apache-2.0
"""The world of the soak: objects that are seen well and badly, and someone who pushes the hand; all by a seed."""

from __future__ import annotations

from collections import Counter

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node

from tpgmm_core.manifold import POSE
from tpgmm_ros import conversions
from tpgmm_ros.lockstep import nothing_seen
from tpgmm_ros.pick_place import Array, random_situation
from tpgmm_ros.qos import STREAM
from tpgmm_ros.task import Task

#: How probably a fault begins at a tick of 10 ms, and how long it lasts, s.
FAULTS = {
    "hidden": (0.0020, (0.1, 3.5)),
    "leaping": (0.0010, (0.01, 0.3)),
    "no pose": (0.0010, (0.01, 0.5)),
    "wrong frame_id": (0.0010, (0.01, 0.5)),
}
PUSH = (0.0010, (0.05, 0.3))
FORCE = 20.0  # N
LEAP = 0.08  # m
TICK = 0.01


class SoakWorld:
    """Answers each pose of the hand with one of each frame, with faults.

    elapsed : simulated time, s, over all lives of the simulator
    happened : how often each kind of fault began
    """

    def __init__(self, node: Node, task: Task, random: np.random.Generator) -> None:
        self.elapsed = 0.0
        self.happened: Counter[str] = Counter()
        self._task, self._random = task, random
        self._places: dict[str, Array] = {}
        self._ends: dict[tuple[str, str], float] = {}
        self._leap = np.zeros(6)
        self._force, self._push_ends = np.zeros(6), 0.0
        self._stamp_ns = 0
        self._said: dict[str, PoseStamped] = {}
        self._publishers = {
            name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()
        }
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self.rearrange()
        node.create_subscription(PoseStamped, task.movement, self._answer, STREAM)

    def rearrange(self) -> None:
        """Everything lies somewhere else from now on."""
        situation = random_situation(self._random)
        self._places = {"object": situation.object, "target": situation.target}

    def _answer(self, message: PoseStamped) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns != self._stamp_ns:
            self._stamp_ns = stamp_ns
            self.elapsed += TICK
            self._said = {name: self._look(name, place) for name, place in self._places.items()}
            self._push()
        for name, said in self._said.items():
            self._publishers[name].publish(said)

    def _look(self, name: str, place: Array) -> PoseStamped:
        for fault, (probability, duration) in FAULTS.items():
            if self._random.random() < probability and self.elapsed > self._ends.get((name, fault), 0.0):
                self._ends[name, fault] = self.elapsed + self._random.uniform(*duration)
                self._leap = self._random.uniform(-LEAP, LEAP, 6)
                self.happened[fault] += 1
        going_on = {fault for fault in FAULTS if self.elapsed < self._ends.get((name, fault), 0.0)}
        if "hidden" in going_on:
            return nothing_seen(self._stamp_ns, self._task.base_frame)
        pose = POSE.exp(place, self._leap) if "leaping" in going_on else place.copy()
        if "no pose" in going_on:
            pose[self._random.integers(7)] = np.nan
        frame_id = "camera" if "wrong frame_id" in going_on else self._task.base_frame
        return conversions.pose_stamped(pose, self._stamp_ns, frame_id)

    def _push(self) -> None:
        probability, duration = PUSH
        if self._random.random() < probability and self.elapsed > self._push_ends:
            self._push_ends = self.elapsed + self._random.uniform(*duration)
            self._force = np.append(self._random.normal(size=3), np.zeros(3))
            self._force *= FORCE / np.linalg.norm(self._force)
            self.happened["pushes"] += 1
        if self.elapsed < self._push_ends:
            self._wrenches.publish(conversions.wrench_from_array(self._force, self._stamp_ns, "left_gripper"))
