# SPDX-License-Identifier: Apache-2.0
"""The world of the soak: objects that are seen well and badly, and someone who pushes the hand; all by a seed."""

from __future__ import annotations

from collections import Counter

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_demos.scene.perception import CameraConfig, SimulatedCamera
from tpgmm_demos.scene.pick_place import random_placement
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.lockstep import nothing_seen
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task

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
    """Answers each pose of the hand with what a camera sees of each frame, with faults.

    Parameters
    ----------
    elapsed
        simulated time, s, over all lives of the simulator
    happened
        how often each kind of fault began
    """

    def __init__(self, node: Node, task: Task, random: np.random.Generator) -> None:
        self.elapsed = 0.0
        self.happened: Counter[str] = Counter()
        self._task, self._random = task, random
        self._camera = SimulatedCamera(CameraConfig(), int(random.integers(1 << 31)))
        self._misfortunes: dict[str, set[str]] = {}
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
        situation = random_placement(self._random)
        self._places = {"object": situation.object, "target": situation.target}

    def _answer(self, message: PoseStamped) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns != self._stamp_ns:
            self._stamp_ns = stamp_ns
            self.elapsed += TICK
            self._misfortunes = {name: self._meet(name) for name in self._places}
            in_sight = {name: place for name, place in self._places.items() if "hidden" not in self._misfortunes[name]}
            sighting = self._camera.look(stamp_ns, in_sight)
            seen = {} if sighting is None else sighting.poses
            taken_ns = stamp_ns if sighting is None else sighting.stamp_ns
            self._said = {
                name: self._say(name, seen[name], taken_ns)
                if name in seen
                else nothing_seen(stamp_ns, self._task.base_frame)
                for name in self._places
            }
            self._push()
        for name, said in self._said.items():
            self._publishers[name].publish(said)

    def _meet(self, name: str) -> set[str]:
        """The faults that a frame suffers at this moment."""
        for fault, (probability, duration) in FAULTS.items():
            if self._random.random() < probability and self.elapsed > self._ends.get((name, fault), 0.0):
                self._ends[name, fault] = self.elapsed + self._random.uniform(*duration)
                self._leap = self._random.uniform(-LEAP, LEAP, 6)
                self.happened[fault] += 1
        return {fault for fault in FAULTS if self.elapsed < self._ends.get((name, fault), 0.0)}

    def _say(self, name: str, seen: Array, stamp_ns: int) -> PoseStamped:
        """What is said of a frame that was seen."""
        pose = POSE.exp(seen, self._leap) if "leaping" in self._misfortunes[name] else seen
        if "no pose" in self._misfortunes[name]:
            pose[self._random.integers(7)] = np.nan
        frame_id = "camera" if "wrong frame_id" in self._misfortunes[name] else self._task.base_frame
        return conversions.pose_stamped(pose, stamp_ns, frame_id)

    def _push(self) -> None:
        probability, duration = PUSH
        if self._random.random() < probability and self.elapsed > self._push_ends:
            self._push_ends = self.elapsed + self._random.uniform(*duration)
            self._force = np.append(self._random.normal(size=3), np.zeros(3))
            self._force *= FORCE / np.linalg.norm(self._force)
            self.happened["pushes"] += 1
        if self.elapsed < self._push_ends:
            self._wrenches.publish(conversions.wrench_from_array(self._force, self._stamp_ns, "left_gripper"))
