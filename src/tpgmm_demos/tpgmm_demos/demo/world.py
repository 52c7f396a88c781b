# SPDX-License-Identifier: Apache-2.0
"""The world around the robot in the demo: objects that are seen, pushed, hidden, grasped and carried."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from tpgmm_core.common.blending import minimum_jerk
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.geometry.pose import pose_error
from tpgmm_demos.scene.perception import SimulatedCamera
from tpgmm_demos.scene.pick_place import Grasp, Placement, hand_at
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.lockstep import nothing_seen
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task

#: Exact perception sees the objects this often, Hz: at every third pose of the hand.
EXACT_RATE = 100.0 / 3.0


@dataclass(frozen=True, slots=True)
class Disturbances:
    """What happens while the arm moves; times in s since the start of the movement.

    Parameters
    ----------
    push_start, push_duration
        someone pushes the object on, smoothly ...
    push
        ... by this much (6,): m, and rad about the fixed axes.
    hide_frame, hide_start, hide_duration
        nobody sees this frame for a while
    """

    push_start: float
    push_duration: float
    push: Array
    hide_frame: str
    hide_start: float
    hide_duration: float

    @classmethod
    def random(cls, random: np.random.Generator, duration: float) -> Disturbances:
        """A push of 4 to 6 cm and up to 15 deg on the way to the object; the target hidden for 1 s on the way to it."""
        direction = random.uniform(0.0, 2.0 * np.pi)
        reach = random.uniform(0.04, 0.06)
        turn = random.uniform(-0.26, 0.26)
        push = np.array([reach * np.cos(direction), reach * np.sin(direction), 0.0, 0.0, 0.0, turn])
        return cls(
            push_start=0.06 * duration,
            push_duration=1.0,
            push=push,
            hide_frame="target",
            hide_start=0.6 * duration,
            hide_duration=1.0,
        )

    def pushed(self, place: Array, time: float) -> Array:
        """Where an object that lay at ``place`` lies at a time."""
        share = minimum_jerk((time - self.push_start) / self.push_duration)
        return POSE.exp(place, share * self.push)

    def hides(self, frame: str, time: float) -> bool:
        """Whether a frame cannot be seen at a time, s since the start of the movement."""
        return frame == self.hide_frame and 0.0 <= time - self.hide_start < self.hide_duration


class World:
    """Publishes the poses of object and target as a camera would, and answers to what the hand does.

    Parameters
    ----------
    node
        publishes and subscribes
    task
        the topics
    situation
        where things lie at first
    disturbances
        what happens on the way
    camera
        sees object and target
    lockstep
        answer each pose of the hand with one message for each frame, also where it is not seen; the movement starts
        with the first one
    publish
        gets what the camera finds, the object's name and its pose; None: published on the task's topics

    Attributes
    ----------
    started_ns
        stamp of the movement's start, ns; as long as it is None, the disturbances wait
    nearest
        how near (m, rad) the hand came to where it could grasp the object
    """

    def __init__(
        self,
        node: Node,
        task: Task,
        situation: Placement,
        disturbances: Disturbances,
        camera: SimulatedCamera,
        lockstep: bool = False,
        publish: Callable[[str, PoseStamped], None] | None = None,
    ) -> None:
        self.situation = situation
        self.disturbances = disturbances
        self.grasp = Grasp(situation.object)
        self.started_ns: int | None = None
        self._task = task
        self.camera = camera
        self._lockstep = lockstep
        self._sights: list[tuple[int, float, Collection[str]]] = []
        self.nearest = np.inf, np.inf
        self._answered_ns = -1
        self._said: dict[str, PoseStamped] = {}
        self._publish = publish or _publisher(node, task)
        node.create_subscription(PoseStamped, task.movement, self._answer, STREAM)

    def in_sight_s(self, since_ns: int) -> dict[str, float]:
        """For how long each of the objects could be seen since a stamp, s.

        By stamps, since in real time the world hears of the movement's start only some time after it.

        Parameters
        ----------
        since_ns
            the stamp, ns

        Returns
        -------
        dict[str, float]
            s by the object's name
        """
        seen = [sight for sight in self._sights if sight[0] >= since_ns]
        return {name: sum(elapsed for _, elapsed, names in seen if name in names) for name in self._task.topics}

    def _answer(self, message: PoseStamped) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns != self._answered_ns:
            if self._lockstep and self.started_ns is None:
                self.started_ns = stamp_ns
            elapsed = 1e-9 * (stamp_ns - self._answered_ns) if self._answered_ns >= 0 else 0.0
            self._answered_ns = stamp_ns
            self._live(conversions.pose_to_array(message.pose), stamp_ns, elapsed)
        for name, said in self._said.items():
            self._publish(name, said)

    def _live(self, hand: Array, stamp_ns: int, elapsed: float) -> None:
        """What happens until a moment, with the hand where it is then, and what is known of it."""
        time = -np.inf if self.started_ns is None else 1e-9 * (stamp_ns - self.started_ns)
        self.grasp.move_object(self.disturbances.pushed(self.situation.object, time))
        self.grasp.update(hand, 1e-9 * stamp_ns)
        if not self.grasp.holds:
            self.nearest = min(self.nearest, pose_error(hand, hand_at(self.grasp.object)))
        places = {"target": self.situation.target, "object": self.grasp.object}
        in_sight = {name: place for name, place in places.items() if self._is_in_sight(name, time)}
        self._sights.append((stamp_ns, elapsed, in_sight.keys()))
        sighting = self.camera.look(stamp_ns, in_sight)
        self._said = {}
        for name in places:
            if sighting is not None and name in sighting.poses:
                pose = sighting.poses[name]
                self._said[name] = conversions.pose_stamped(pose, sighting.stamp_ns, self._task.base_frame)
            elif self._lockstep:
                self._said[name] = nothing_seen(stamp_ns, self._task.base_frame)

    def _is_in_sight(self, name: str, time: float) -> bool:
        is_held = name == "object" and self.grasp.holds
        return not is_held and not self.disturbances.hides(name, time)


def _publisher(node: Node, task: Task) -> Callable[[str, PoseStamped], None]:
    """What publishes the pose of an object on its topic."""
    publishers = {name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()}
    return lambda name, pose: publishers[name].publish(pose)
