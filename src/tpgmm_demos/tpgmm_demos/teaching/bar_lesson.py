# SPDX-License-Identifier: Apache-2.0
"""A scripted lesson in priorities: a bar between both hands, and a target for each, farther apart than the bar is long.

The teacher leads both hands, and the elbows a little. The hand that is meant to have priority is at its target; the bar
points to the other target, which the other hand then cannot reach. For some of the time both can be reached.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from tpgmm_core.common.blending import minimum_jerk
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.scene.perception import SimulatedCamera
from tpgmm_demos.teaching.teacher import Teacher, TeacherConfig
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task

HANDS = ("left", "right")
DURATION = 12.0  # s
#: Steps of the simulation per second, and how often it publishes poses and waits for a wrench, Hz: hands and elbows
#: take turns.
RATE, TOUCH_RATE = 500.0, 500.0
#: One of so many poses is recorded; exact perception sees the targets then.
KEEP_EVERY = 10
#: Both hands look where it matters; elbows are only kept from drifting.
HAND = TeacherConfig(stiffness=(2000.0, 60.0), damping=(110.0, 2.0), correction=6.0, max_force=90.0, max_torque=15.0)
ELBOW = TeacherConfig(stiffness=(300.0, 0.0), damping=(30.0, 0.0), correction=0.0, max_force=30.0, max_torque=0.0)
#: An elbow goes along with its hand by this share.
ELBOW_SHARE = 0.5
#: How surely hands are kept where they are meant to be: amplitude of slow wavering, m.
WAVER = 0.002
#: This near, the teacher corrects what is left, m.
NEAR = 0.02
#: A demonstration in which the hand with priority is farther from its target shows something else, m.
MAX_ERROR = 0.04


class Targets:
    """Where both targets are over time: wandering together, turning about each other, now and then too far apart.

    Parameters
    ----------
    hands
        positions (3,) of both hands at the beginning, m
    first
        the hand whose target wanders; the other target goes away from it and comes nearer
    random
        where the variation comes from
    """

    def __init__(self, hands: dict[str, Array], first: str, random: np.random.Generator) -> None:
        self._first, self._other = first, HANDS[1 - HANDS.index(first)]
        self._start = hands[self._first]
        self._bar = hands[self._other] - self._start
        self._amplitudes = random.uniform(0.5, 1.0, 3) * [0.05, 0.04, 0.04] * random.choice([-1.0, 1.0], 3)
        self._rates = random.permutation([1.0, 2.0, 3.0])
        self._turn = random.uniform(0.1, 0.25) * random.choice([-1.0, 1.0], 2)
        self._far, self._near = random.uniform(0.14, 0.18), random.uniform(0.08, 0.12)

    def at(self, time: float) -> dict[str, Array]:
        """Positions (3,) of the targets, m, at a time in s."""
        s = min(1.0, max(0.0, time / DURATION))
        place = self._start + self._amplitudes * np.sin(np.pi * s) * np.sin(np.pi * self._rates * s)
        turn = self._turn * np.sin(2.0 * np.pi * s)
        way = quaternion.rotation_matrix(quaternion.exp([turn[0], 0.0, turn[1]])) @ self._bar
        stretch = self._far * _bump(s, 0.1, 0.45) - self._near * _bump(s, 0.55, 0.9)
        return {self._first: place, self._other: place + way * (1.0 + stretch / float(np.linalg.norm(way)))}


def _bump(s: float, begin: float, end: float) -> float:
    """Rises from 0 to 1 and falls again, smoothly, and stays at 1 for a third of the time."""
    u = (s - begin) / (end - begin)
    return minimum_jerk(3.0 * min(u, 1.0 - u))


@dataclass(frozen=True, slots=True)
class Bar:
    """What both hands hold. poses : (7,) of the hands at the beginning, by name."""

    poses: dict[str, Array]

    def hands(self, targets: dict[str, Array], first: str) -> dict[str, Array]:
        """Poses (7,) of both hands with one of them at its target and the bar pointing to the other target."""
        start = {hand: pose[:3] for hand, pose in self.poses.items()}
        bar, way = start["right"] - start["left"], targets["right"] - targets["left"]
        length = float(np.linalg.norm(bar))
        bar, way = bar / length, way / np.linalg.norm(way)
        turn = quaternion.normalize(np.append(np.cross(bar, way), 1.0 + bar @ way))  # the shortest one
        left = targets["left"] if first == "left" else targets["right"] - length * way
        places = {"left": left, "right": left + length * way}
        return {hand: np.concatenate([places[hand], quaternion.multiply(turn, self.poses[hand][3:])]) for hand in HANDS}


@dataclass(frozen=True, slots=True)
class _Held:
    """An aim that is known at each moment. Who is far from it goes there first, and corrects what is left."""

    pose: Array
    is_near: bool = True

    def at(self, time: float) -> tuple[Array, bool]:
        return self.pose, self.is_near


class BarLesson:
    """One demonstration: the teacher's forces, answered to each state at which the simulation waits for them.

    Parameters
    ----------
    node
        publishes and subscribes
    task
        topics of the targets, by the frames `left_target` and `right_target`
    robot_file
        the robot that is led
    first
        the hand that has priority
    camera
        sees the targets
    random
        where the variation comes from

    Attributes
    ----------
    done
        whether it is over
    duration
        s
    failure
        what the teacher did not manage; empty if all went well
    """

    def __init__(
        self, node: Node, task: Task, robot_file: Path, first: str, camera: SimulatedCamera, random: np.random.Generator
    ) -> None:
        self.done, self.duration, self.failure = False, DURATION, ""
        self._task, self._first, self._camera, self._random = task, first, camera, random
        self._robot = RobotModel.from_file(robot_file)
        self._data = self._robot.create_data()
        self._reader = JointReader(self._robot.joint_names)
        self._links = {hand: self._robot.endpoints[hand].frame for hand in HANDS}
        self._links |= {f"{hand} elbow": f"{hand}_lower_elbow" for hand in HANDS}
        self._frame_ids = {name: self._robot.frame_id(link) for name, link in self._links.items()}
        self._teachers: dict[str, Teacher[_Held]] = {}
        self._ticks = 0
        self._stamp_ns = -1
        self._answer: WrenchStamped | None = None
        self._node = node
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self._places = {
            hand: node.create_publisher(PoseStamped, task.topics[f"{hand}_target"], STREAM) for hand in HANDS
        }
        self._subscription = node.create_subscription(JointState, "joint_states", self._take, STREAM)

    def close(self) -> None:
        """Take everything off the topics."""
        self._node.destroy_subscription(self._subscription)
        for publisher in (self._wrenches, *self._places.values()):
            self._node.destroy_publisher(publisher)

    def _take(self, message: JointState) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns % round(1e9 / TOUCH_RATE):
            return
        if stamp_ns > self._stamp_ns:
            self._stamp_ns = stamp_ns
            (q,) = self._reader.read(message, "position")
            self._data.update(q)
            poses = {name: self._data.frame_pose(frame_id) for name, frame_id in self._frame_ids.items()}
            self._answer = self._advance(1e-9 * stamp_ns, poses)
        if self._answer is not None:  # a state that comes again did not get its answer
            self._wrenches.publish(self._answer)

    def _advance(self, now: float, poses: dict[str, Array]) -> WrenchStamped:
        if not self._teachers:
            self._begin(now, poses)
        time = now - self._start
        targets = self._targets.at(time)
        places = {hand: np.concatenate([targets[hand], quaternion.IDENTITY]) for hand in HANDS}
        sighting = self._camera.look(self._stamp_ns, places)
        if sighting is not None:
            for hand, pose in sighting.poses.items():
                self._places[hand].publish(conversions.pose_stamped(pose, sighting.stamp_ns, self._task.base_frame))
        name = list(self._links)[self._ticks % len(self._links)]
        self._ticks += 1
        self.done = time >= DURATION
        hand = name.split()[0]
        aims = self._bar.hands(targets, self._first)
        error = float(np.linalg.norm(poses[self._first][:3] - targets[self._first]))
        if error > MAX_ERROR:
            self.failure = f"the {self._first} hand was {error:.3f} m from its target {time:.1f} s after the start"
        aims[hand][:3] += WAVER * np.sin(self._waver[hand][0] * time + self._waver[hand][1])
        if name != hand:  # its elbow
            way = ELBOW_SHARE * (aims[hand][:3] - self._begin_poses[hand][:3])
            aims[name] = self._begin_poses[name] + np.append(way, np.zeros(4))
        teacher = self._teachers[name]
        teacher.intention = _Held(aims[name], float(np.linalg.norm(poses[name][:3] - aims[name][:3])) < NEAR)
        wrench = teacher.wrench(time, poses[name])
        return conversions.wrench_from_array(wrench, self._stamp_ns, self._links[name])

    def _begin(self, now: float, poses: dict[str, Array]) -> None:
        self._start, self._begin_poses = now, poses
        self._bar = Bar({hand: poses[hand] for hand in HANDS})
        self._targets = Targets({hand: poses[hand][:3] for hand in HANDS}, self._first, self._random)
        self._waver = {
            hand: (self._random.uniform(2.0, 6.0, 3), self._random.uniform(0.0, 2.0 * np.pi, 3)) for hand in HANDS
        }
        for name in self._links:
            config = HAND if name in HANDS else ELBOW
            self._teachers[name] = Teacher(_Held(poses[name]), config)
