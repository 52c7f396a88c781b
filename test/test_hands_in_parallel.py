# SPDX-License-Identifier: Apache-2.0
"""joint_reference with movements of two hands, each with its own phase: their product in joint space moves both."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ROOT, SECOND, Inbox, ros_arguments
from ros_testing import StartProcess, spin_until
from tpgmm_core import Demonstration, Frame
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.msg import Reference
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.models.task_model import make_task_retrieval
from tpgmm_ros.task.task_file import Task

ROBOT_FILE = ROOT / "config" / "baxter.yaml"
TICK_NS = 10_000_000
DIMENSIONS = ("x", "y", "z", "qx", "qy", "qz", "qw")
#: Of each hand: how far its object is from where it begins, m, and how long it was shown to take, s.
WAYS = {"left": (np.array([0.08, 0.06, 0.05]), 1.0), "right": (np.array([0.05, -0.08, -0.04]), 0.6)}
TASK = (
    "{{name: {0}, base_frame: base, movement: endpoint/{0}/pose, endpoint: {0}, "
    "frames: {{object: {{topic: object/pose}}}}}}"
)


def learn(directory: Path, hand: str, home: np.ndarray) -> Retrieval:
    """A movement, learned, of a hand to its object."""
    task_file = directory / f"{hand}.yaml"
    task_file.write_text(TASK.format(hand))
    space, random, (way, seconds) = Task.load(task_file).space, np.random.default_rng(0), WAYS[hand]
    times, shown = np.linspace(0.0, seconds, 30), []
    s = times / seconds
    share = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]
    for _ in range(5):
        start = home + [*random.uniform(-0.1, 0.1, 3), 0.0, 0.0, 0.0, 0.0]
        steps = np.hstack([share * way, np.zeros((30, 3))]) + random.normal(0.0, 0.002, (30, 6))
        data = np.stack([POSE.exp(start, step) for step in steps])
        frames = {"object": Frame.from_pose(start[:3] + way, home[3:]).with_time()}
        shown.append(Demonstration(times, np.column_stack([times, data]), frames))
    model = Recipe.of({"n_components": 4, "reg_covar": 1e-6}).learn(shown, space.manifold(), space.dimensions())
    model.metadata_ = {**model.metadata_, "duration_s": seconds}
    return make_task_retrieval(model, Task.load(task_file))


class Robot:
    """Joints that are at each tick where the reference was, as fast as they may; and a camera for its objects."""

    def __init__(self, node: Node) -> None:
        self.node, self.model = node, RobotModel.from_file(ROBOT_FILE)
        self.data, self.q, self.stamp_ns = self.model.create_data(), self.model.home.copy(), 10 * SECOND
        self.data.update(self.q)
        self.homes = {hand: self.data.pose(hand).copy() for hand in WAYS}
        self.inbox = Inbox(node, Reference, "reference")
        self._states = node.create_publisher(JointState, "joint_states", STREAM)
        self._references = {h: node.create_publisher(Reference, f"{h}/reference", STREAM) for h in WAYS}

    def lead(self, movements: Mapping[str, Retrieval]) -> list[float]:
        """Publish what movements say now; returns their phases."""
        phases = []
        for hand, movement in movements.items():
            place = Frame.from_pose(self.homes[hand][:3] + WAYS[hand][0], self.homes[hand][3:]).with_time()
            said = movement.step(self.stamp_ns, {"object": place}, self.data.pose(hand))
            self._references[hand].publish(conversions.reference_message(said, DIMENSIONS, self.stamp_ns, "base"))
            phases.append(said.phase)
        return phases

    @property
    def is_heard(self) -> bool:
        """Whether the node listens to all, and is listened to."""
        publishers = (self._states, *self._references.values())
        return all(p.get_subscription_count() for p in publishers) and self.node.count_publishers("reference") > 0

    def tick(self) -> None:
        """A joint state, later ones until one is answered; then the joints move."""
        message, due = JointState(name=list(self.model.joint_names), position=self.q.tolist()), 0.0

        def is_answered() -> bool:
            last = self.inbox.last
            return last is not None and conversions.time_to_ns(last.header.stamp) == self.stamp_ns

        def is_answered_or_told_again() -> bool:
            nonlocal due
            if time.monotonic() >= due:  # best effort may lose a message
                due = time.monotonic() + 0.2
                self.stamp_ns += TICK_NS
                message.header.stamp = conversions.time_from_ns(self.stamp_ns)
                self._states.publish(message)
            return is_answered()

        spin_until(self.node, is_answered_or_told_again, message="an answer")
        joints = [self.model.joint_names.index(name) for name in self.inbox.last.dimensions]
        self.q[joints] += np.clip(np.array(self.inbox.last.gaussian.mean) - self.q[joints], -0.03, 0.03)
        self.data.update(self.q)


def test_each_hand_reaches_its_object_at_its_own_pace_while_the_other_one_moves(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    robot = Robot(ros_node)
    movements = {hand: learn(tmp_path, hand, robot.homes[hand]) for hand in WAYS}
    start_process("joint_reference", *ros_arguments(robot_file=ROBOT_FILE, led="[left, right]", blend_time=0.05))
    spin_until(ros_node, lambda: robot.is_heard, message="joint_reference to listen")
    robot.tick()
    assert not robot.inbox.last.frames, "nothing leads the robot yet"
    np.testing.assert_allclose(robot.q, robot.model.home, atol=1e-9)
    for movement in movements.values():
        movement.start(robot.stamp_ns)
    away = []
    for _ in range(130):
        phases = robot.lead(movements)
        robot.tick()
        away.append([np.linalg.norm(robot.data.pose(h)[:3] - robot.homes[h][:3] - WAYS[h][0]) for h in WAYS])
    assert phases == [1.0, 1.0]
    assert set(robot.inbox.last.frames) == {"left/object", "right/object"}
    distances = np.array(away)
    assert distances[-1].max() < 0.01
    first = [int(np.argmax(distances[:, i] < 0.01)) for i in range(2)]
    assert 20 < first[0] - first[1] < 60, "the right hand is there first, and stays"
    assert distances[first[1] :, 1].max() < 0.01
    for _ in range(60):  # nobody says anything any more
        robot.tick()
    assert not robot.inbox.last.frames
