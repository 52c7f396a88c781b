# SPDX-License-Identifier: Apache-2.0
"""frame_tracker with publishers that say a thing once and keep it for those who come later (transient local)."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from ros_graph import ALL_LATCHED, ROBOT_FILE, SECOND, Diagnostics, Inbox, ros_arguments
from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_core.observation.signals import STEADY
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_msgs.msg import TaskFrame, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import EVENTS, LATCHED, STREAM

vision_msgs = pytest.importorskip("vision_msgs.msg", reason="vision_msgs is not built here: run 'make setup'")

HEAD = "{name: kept, base_frame: base, movement: hand/pose, endpoint: left, tracking: {hold_time: 0.3}, frames: %s}"
FRAMES = """\
{stamped: {topic: stamped},
covariance: {topic: covariance, type: geometry_msgs/PoseWithCovarianceStamped},
transform: {topic: transform, type: geometry_msgs/TransformStamped, child: cup},
odometry: {topic: odometry, type: nav_msgs/Odometry},
detection: {topic: seen, type: vision_msgs/Detection3DArray, class: cup},
other: {topic: frames, type: tpgmm_msgs/TaskParameters, name: cup}}
"""
HERE = np.array([0.6, 0.4, 0.1, 0.0, 0.0, 0.6, 0.8])
THERE = np.array([-0.6, 1.4, 0.3, 0.0, 0.6, 0.0, 0.8])


def messages(pose: np.ndarray, stamp: int) -> dict[str, Any]:
    """A message for each topic that says that the cup is there."""
    header, place = conversions.header_at(stamp, "base"), conversions.pose_from_array(pose)
    covariance, odometry = PoseWithCovarianceStamped(header=header), Odometry(header=header)
    covariance.pose.pose = odometry.pose.pose = place
    transform = TransformStamped(header=header, child_frame_id="cup")
    transform.transform.rotation = place.orientation
    for axis in "xyz":
        setattr(transform.transform.translation, axis, getattr(place.position, axis))
    result = vision_msgs.ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score, result.pose.pose = "cup", 0.9, place
    seen = vision_msgs.Detection3DArray(header=header, detections=[vision_msgs.Detection3D(results=[result])])
    tracked = TrackedFrame("cup", FrameStatus.VISIBLE, 1.0, stamp, pose)
    return {
        "stamped": PoseStamped(header=header, pose=place),
        "covariance": covariance,
        "transform": transform,
        "odometry": odometry,
        "seen": seen,
        "frames": conversions.task_parameters_message([tracked], stamp, "base"),
    }


class Tracked:
    """A frame_tracker, and what it says."""

    def __init__(self, node: Node, process: RunningProcess) -> None:
        self.node, self.process = node, process
        self.inbox = Inbox(node, TaskParameters, "task_parameters", ALL_LATCHED)
        self.diagnostics = Diagnostics(node)

    def are(self, status: int, pose: np.ndarray | None = None) -> bool:
        """Whether all frames have a status, and are at a pose."""
        frames = self.inbox.last.frames if self.inbox.last is not None else []
        return bool(frames) and all(
            frame.status == status and (pose is None or np.allclose(frame.b[:3], pose[:3], atol=1e-9))
            for frame in frames
        )

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        spin_until(self.node, condition, message=what, processes=(self.process,))


@pytest.fixture
def start(ros_node: Node, start_process: StartProcess, tmp_path: Path) -> Callable[..., Tracked]:
    def start(frames: str, *command: str, **parameters: object) -> Tracked:
        (tmp_path / "task.yaml").write_text(HEAD % frames)
        arguments = ros_arguments(task_file=tmp_path / "task.yaml", **parameters)
        return Tracked(ros_node, start_process(*(command or ("frame_tracker",)), *arguments))

    return start


@pytest.mark.parametrize(
    ("before", "command"),
    [
        (True, ["frame_tracker"]),
        (False, ["frame_tracker"]),
        (True, ["compose", "frame_tracker", "endpoint_poses"]),
    ],
    ids=["before the tracker starts", "after it has started", "before, in one process with another node"],
)
def test_what_is_said_once_holds_until_something_else_is_said_and_while_it_is_kept(
    before: bool, command: list[str], ros_node: Node, start: Callable[..., Tracked]
) -> None:
    if not before:
        tracked = start(FRAMES, *command, robot_file=ROBOT_FILE)
        tracked.wait(lambda: tracked.are(TaskFrame.MISSING), "the tracker")
    old = ros_node.get_clock().now().nanoseconds - 3600 * SECOND
    publishers = {
        topic: ros_node.create_publisher(type(message), topic, LATCHED) for topic, message in messages(HERE, 0).items()
    }

    def say(pose: np.ndarray, stamp: int) -> None:
        for topic, message in messages(pose, stamp).items():
            publishers[topic].publish(message)

    say(HERE, old)
    if before:
        tracked = start(FRAMES, *command, robot_file=ROBOT_FILE)
    tracked.wait(lambda: tracked.are(TaskFrame.VISIBLE, HERE), "what was said")
    tracked.inbox.clear()
    tracked.wait(lambda: len(tracked.inbox.messages) > 150, "more than one and a half seconds")
    assert all(frame.status == TaskFrame.VISIBLE for message in tracked.inbox.messages for frame in message.frames)
    tracked.wait(
        lambda: "keeps it" in tracked.diagnostics.values.get("frame_tracker", {}).get("note_stamped_1", ""),
        "the diagnostics to say why",
    )
    # farther than a thing can go meanwhile, without a stamp
    say(THERE, 0)
    tracked.wait(lambda: tracked.are(TaskFrame.VISIBLE, THERE), "what was said next")
    for publisher in publishers.values():
        ros_node.destroy_publisher(publisher)
    tracked.wait(lambda: tracked.are(TaskFrame.MISSING), "what nobody keeps to be lost")
    assert "refused" not in tracked.process.output and "is not heard" not in tracked.process.output


def test_streams_come_after_what_was_said_once_and_are_held_and_lost_when_they_stop(
    ros_node: Node, start: Callable[..., Tracked]
) -> None:
    tracked = start("{cup: {topic: cup}}")
    once, stream = (ros_node.create_publisher(PoseStamped, "cup", qos) for qos in (LATCHED, STREAM))
    once.publish(conversions.pose_stamped(HERE, 0, "base"))

    def streaming() -> bool:
        stream.publish(conversions.pose_stamped(THERE, ros_node.get_clock().now().nanoseconds, "base"))
        return tracked.are(TaskFrame.VISIBLE, THERE)

    tracked.wait(streaming, "the stream")
    tracked.wait(lambda: tracked.are(TaskFrame.MISSING), "the stream to be lost")
    ros_node.destroy_publisher(stream)
    tracked.wait(lambda: tracked.are(TaskFrame.VISIBLE, HERE), "what was said once, and is kept by all who publish now")


def test_a_publisher_that_keeps_the_last_pose_of_a_stream_is_lost_when_it_stops(
    ros_node: Node, start: Callable[..., Tracked]
) -> None:
    tracked = start("{cup: {topic: cup}}")
    publisher = ros_node.create_publisher(PoseStamped, "cup", LATCHED)

    def publish() -> None:
        publisher.publish(conversions.pose_stamped(HERE, ros_node.get_clock().now().nanoseconds, "base"))

    timer = ros_node.create_timer(1 / 60, publish)
    rate = "rate_cup_hz"
    tracked.wait(lambda: rate in tracked.diagnostics.values.get("frame_tracker", {}), "its rate to be known")
    tracked.wait(lambda: tracked.are(TaskFrame.VISIBLE, HERE), "the frame")
    ros_node.destroy_timer(timer)
    tracked.wait(lambda: tracked.are(TaskFrame.MISSING), "the frame to be lost")


def test_what_was_said_once_is_known_again_after_time_has_jumped_back(
    ros_node: Node, start: Callable[..., Tracked]
) -> None:
    tracked = start("{cup: {topic: cup}}", use_sim_time=True)
    publisher = ros_node.create_publisher(PoseStamped, "cup", LATCHED)
    clock = ros_node.create_publisher(Clock, "/clock", EVENTS)
    publisher.publish(conversions.pose_stamped(HERE, 0, "base"))
    now = [100 * SECOND]

    def tick() -> None:
        now[0] += SECOND // 100
        clock.publish(Clock(clock=conversions.time_from_ns(now[0])))

    ros_node.create_timer(0.01, tick)
    tracked.wait(lambda: tracked.are(TaskFrame.VISIBLE, HERE), "what was said")
    now[0] = 10 * SECOND
    tracked.wait(lambda: "time jumped backwards" in tracked.process.output, "the jump")

    def is_known_again() -> bool:
        stamp_ns = conversions.time_to_ns(tracked.inbox.last.header.stamp)
        return 12 * SECOND < stamp_ns < 90 * SECOND and tracked.are(TaskFrame.VISIBLE, HERE)

    tracked.wait(is_known_again, "what is kept")


def test_a_gripper_that_said_once_that_it_is_closed_holds_what_is_in_it(
    ros_node: Node, start: Callable[..., Tracked]
) -> None:
    gripper = ros_node.create_publisher(Bool, "closed", LATCHED)
    gripper.publish(Bool(data=True))
    tracked = start("{nut: {topic: nut, unseen: {with: hand, gripper: {topic: closed, type: std_msgs/Bool}}}}")
    hands, nuts = (ros_node.create_publisher(PoseStamped, topic, STREAM) for topic in ("hand/pose", "nut"))

    def live(seen: bool) -> None:
        stamp = ros_node.get_clock().now().nanoseconds
        hands.publish(conversions.pose_stamped(HERE, stamp, "base"))
        if seen:
            nuts.publish(conversions.pose_stamped(HERE, stamp, "base"))

    def note() -> str:
        return tracked.diagnostics.values.get("frame_tracker", {}).get("note_nut_1", "")

    def says(*words: str) -> Callable[[], bool]:
        def check() -> bool:
            live(seen=False)
            return any(item in note() for item in words)

        return check

    def seen() -> bool:
        live(seen=True)
        return tracked.are(TaskFrame.VISIBLE, HERE)

    tracked.wait(seen, "the nut")
    tracked.wait(says("the gripper spoke last"), "what it has said before")
    gripper.publish(Bool(data=False))
    tracked.wait(says("the gripper is open", "where the gripper let it go"), "the open gripper")
    gripper.publish(Bool(data=True))
    tracked.wait(says("moves with the hand, whose gripper holds it; the gripper spoke last"), "the closed gripper")


def test_what_a_gripper_says_once_is_heard_among_what_the_arm_says_on_the_same_topic(
    ros_node: Node, start: Callable[..., Tracked]
) -> None:
    states = ros_node.create_publisher(JointState, "joint_states", QoSProfile(depth=100))
    gripper = 'topic: joint_states, type: sensor_msgs/JointState, field: "position[finger]", below: 0.03'
    tracked = start(f"{{nut: {{topic: nut, unseen: {{with: hand, gripper: {{{gripper}}}}}}}}}")
    hands, nuts = (ros_node.create_publisher(PoseStamped, topic, STREAM) for topic in ("hand/pose", "nut"))

    def live(*publishers: Publisher) -> None:
        stamp = ros_node.get_clock().now().nanoseconds
        for publisher in publishers:
            publisher.publish(conversions.pose_stamped(HERE, stamp, "base"))

    def seen() -> bool:
        live(hands, nuts)
        return tracked.are(TaskFrame.VISIBLE, HERE)

    tracked.wait(seen, "the nut")
    for width, words in ((0.01, "whose gripper holds it"), (0.08, "where the gripper let it go")) * 2:
        tracked.process.send_signal(signal.SIGSTOP)  # it is busy
        states.publish(JointState(name=["finger"], position=[width]))
        for _ in range(20):
            states.publish(JointState(name=["shoulder", "elbow"], position=[0.0, 0.0]))
        tracked.process.send_signal(signal.SIGCONT)

        def says(words: str = words) -> bool:
            live(hands)
            return words in tracked.diagnostics.values.get("frame_tracker", {}).get("note_nut_1", "")

        tracked.wait(says, words)


def test_a_gripper_that_stops_saying_what_it_said_all_the_time_holds_nothing_until_it_speaks_again(
    ros_node: Node, start: Callable[..., Tracked]
) -> None:
    tracked = start("{nut: {topic: nut, unseen: {with: hand, gripper: {topic: closed, type: std_msgs/Bool}}}}")
    hands, nuts = (ros_node.create_publisher(PoseStamped, topic, STREAM) for topic in ("hand/pose", "nut"))
    gripper = ros_node.create_publisher(Bool, "closed", STREAM)
    said: list[bool] = []
    closed, speaks, seen = [False], [True], [True]

    def live() -> None:
        stamp = ros_node.get_clock().now().nanoseconds
        for publisher in (hands, nuts) if seen[0] else (hands,):
            publisher.publish(conversions.pose_stamped(HERE, stamp, "base"))
        if speaks[0]:
            said.append(closed[0])
            gripper.publish(Bool(data=closed[0]))

    timer = ros_node.create_timer(0.03, live)

    def note() -> str:
        return tracked.diagnostics.values.get("frame_tracker", {}).get("note_nut_1", "")

    tracked.wait(lambda: tracked.are(TaskFrame.VISIBLE, HERE), "the nut")
    seen[0] = False
    tracked.wait(lambda: "the gripper is open" in note(), "the open gripper")
    said.clear()
    closed[0] = True
    tracked.wait(lambda: said.count(True) * 0.03 > STEADY + 1.0, "the gripper to speak all the time")
    assert tracked.are(TaskFrame.HELD, HERE) and note().endswith("whose gripper holds it")
    speaks[0] = False
    tracked.wait(lambda: tracked.are(TaskFrame.MISSING), "what it held to be lost")
    tracked.wait(lambda: "has stopped saying so" in note(), "the diagnostics to say why")
    speaks[0] = True
    tracked.wait(lambda: tracked.are(TaskFrame.HELD, HERE), "the gripper to hold it again")
    ros_node.destroy_timer(timer)
