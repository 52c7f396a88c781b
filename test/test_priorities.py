# SPDX-License-Identifier: Apache-2.0
"""Priorities over topics: learned from bags of both hands, reproduced on a simulated Baxter, all nodes in lockstep."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState

from long_tests import mostly_long
from ros_graph import ALL, ROBOT_FILE, ROOT, Inbox, result_of, ros_arguments
from ros_testing import StartProcess, spin_until
from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.teaching.bar_lesson import HANDS
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import Reference
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.programs import train
from tpgmm_ros.task.task_file import Task

TIMEOUT = 120.0
DURATION = 2.8  # s of simulated time; the targets rest after MOVED s, errors count from COUNTED s on, half-way apart
MOVED, COUNTED = 1.6, 0.8
#: Slower than Baxter's controller needs, so that the test is short.
RATE, POSE_RATE = 500.0, 100.0
#: How much farther apart than the hands the targets get, m.
STRETCH = 0.15


class TwoTargets:
    """The world: the targets move apart, on a path that was not in the demonstrations. Keeps the hands' errors."""

    def __init__(self, node: Node, task: Task) -> None:
        self.errors: list[np.ndarray] = []
        self._task = task
        self._robot = RobotModel.from_file(ROBOT_FILE)
        self._data = self._robot.create_data()
        self._reader = JointReader(self._robot.joint_names)
        self._begin_ns: int | None = None
        self._publishers = {
            hand: node.create_publisher(PoseStamped, task.topics[f"{hand}_target"], STREAM) for hand in HANDS
        }
        node.create_subscription(JointState, "joint_states", self._take, STREAM)

    def _take(self, message: JointState) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns % round(1e9 / POSE_RATE):
            return
        (q,) = self._reader.read(message, "position")
        self._data.update(q)
        places = {hand: self._data.pose(hand)[:3] for hand in HANDS}
        if self._begin_ns is None:
            self._begin_ns, self._start = stamp_ns, places
        time = 1e-9 * (stamp_ns - self._begin_ns)
        share = np.clip(time / MOVED, 0.0, 1.0)
        share = share**2 * (3.0 - 2.0 * share)
        apart = np.array([0.02, -0.5 * STRETCH, 0.0])
        targets = {
            "left": self._start["left"] - share * apart + share * np.array([0.0, 0.0, 0.03]),
            "right": self._start["right"] + share * apart + share * np.array([0.0, 0.0, 0.03]),
        }
        if time >= COUNTED:
            self.errors.append(np.array([np.linalg.norm(targets[hand] - places[hand]) for hand in HANDS]))
        for hand, publisher in self._publishers.items():
            pose = np.concatenate([targets[hand], quaternion.IDENTITY])
            publisher.publish(conversions.pose_stamped(pose, stamp_ns, self._task.base_frame))


@pytest.mark.parametrize("first", mostly_long(HANDS, "left"))
def test_the_hand_that_had_priority_in_the_demonstrations_is_at_its_target(
    ros_node: Node, start_process: StartProcess, tmp_path: Path, first: str
) -> None:
    task_file, model = ROOT / "config" / f"{first}_first.yaml", tmp_path / "model.tpgmm"
    bags = str(ROOT / "bags" / "priorities" / f"{first}_first")
    assert train.main(["--task", str(task_file), "--output", str(model), "--every", "2", bags]) == 0
    task = Task.load(task_file)
    world = TwoTargets(ros_node, task)
    references = Inbox(ros_node, Reference, "reference", ALL)
    both = {"use_sim_time": True, "autostart": True}
    waits = {"start_timeout": TIMEOUT, "settle_time": 0.05}
    processes = (
        start_process("frame_tracker", *ros_arguments(task_file=task_file, lockstep=True, use_sim_time=True)),
        start_process(
            "reproduction",
            *ros_arguments(task_file=task_file, model_file=model, lockstep_rate=POSE_RATE, **waits, **both),
        ),
        start_process(
            "impedance_controller",
            *ros_arguments(robot_file=ROBOT_FILE, joint_state_rate=RATE, lockstep=True, **both),
        ),
    )
    client = ActionClient(ros_node, Reproduce, "reproduce")
    spin_until(ros_node, client.server_is_ready, TIMEOUT, "the action", processes)
    goal = result_of(ros_node, client.send_goal_async(Reproduce.Goal(duration=DURATION)), "the goal", TIMEOUT)
    ended = goal.get_result_async()
    simulator = ros_arguments(robot_file=ROBOT_FILE, lockstep=True, rate=RATE, pose_rate=POSE_RATE)
    process = start_process("baxter_simulator", *simulator)
    spin_until(ros_node, ended.done, TIMEOUT, "the end of the movement", (*processes, process))

    assert ended.result().result.success, ended.result().result.reason
    reference = references.last
    assert tuple(reference.dimensions) == task.space.joints()
    assert set(reference.frames) == {"left_target", "right_target"} and reference.phase == 1.0
    errors = dict(zip(HANDS, np.mean(world.errors, axis=0), strict=True))
    other = HANDS[1 - HANDS.index(first)]
    assert errors[other] > 0.5 * STRETCH, errors  # both cannot be reached
    assert errors[first] <= errors[other] / 5.0, errors
