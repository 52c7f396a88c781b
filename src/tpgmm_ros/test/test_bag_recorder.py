# SPDX-License-Identifier: Apache-2.0
"""Recordings: whole or not at all, and never over another one."""

from __future__ import annotations

from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ros_testing import spin_until
from tpgmm_ros.messages.qos import LATCHED
from tpgmm_ros.recordings.bag_recorder import BagRecorder

TOPICS = {"hand/pose": "geometry_msgs/msg/PoseStamped", "silent/pose": "geometry_msgs/msg/PoseStamped"}


def send(node: Node, recorder: BagRecorder, count: int) -> None:
    """Publish poses one by one, each after the one before has been taken."""
    publisher = node.create_publisher(PoseStamped, "hand/pose", 10)
    spin_until(node, lambda: publisher.get_subscription_count() > 0, message="the recorder to listen")
    for i in range(count):
        message = PoseStamped()
        message.header.frame_id, message.pose.position.x = "base", float(i)
        before = recorder.counts["hand/pose"]
        publisher.publish(message)
        spin_until(node, lambda before=before: recorder.counts["hand/pose"] > before, message="the pose")


def recorded(path: Path) -> list[float]:
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        assert {connection.topic for connection in reader.connections} == {"/hand/pose", "/silent/pose"}
        return [reader.deserialize(raw, c.msgtype).pose.position.x for c, _, raw in reader.messages()]


def test_all_that_came_is_in_the_bag_and_the_bag_is_there_only_when_it_is_complete(
    ros_node: Node, tmp_path: Path
) -> None:
    path = tmp_path / "bags" / "demo_01"
    with BagRecorder(ros_node, TOPICS).into(path) as recorder:
        send(ros_node, recorder, 20)
        assert not path.exists()
    assert recorder.counts == {"hand/pose": 20, "silent/pose": 0}
    assert recorded(path) == [float(i) for i in range(20)]
    assert [item.name for item in path.parent.iterdir()] == ["demo_01"]


def test_of_a_fast_topic_every_nth_message_is_kept(ros_node: Node, tmp_path: Path) -> None:
    with BagRecorder(ros_node, TOPICS, keep_every={"hand/pose": 5}).into(tmp_path / "demo") as recorder:
        send(ros_node, recorder, 20)
    assert recorded(tmp_path / "demo") == [0.0, 5.0, 10.0, 15.0]


def test_an_interrupted_recording_does_not_look_like_a_whole_one_and_the_next_one_succeeds(
    ros_node: Node, tmp_path: Path
) -> None:
    path = tmp_path / "demo_01"
    with pytest.raises(RuntimeError, match="unplugged"), BagRecorder(ros_node, TOPICS).into(path) as recorder:
        send(ros_node, recorder, 3)
        raise RuntimeError("unplugged")
    assert not path.exists() and (tmp_path / ".partial" / "demo_01").exists()
    with BagRecorder(ros_node, TOPICS).into(path) as recorder:
        send(ros_node, recorder, 2)
    assert recorded(path) == [0.0, 1.0]


def test_an_existing_bag_is_refused_before_anything_is_touched(ros_node: Node, tmp_path: Path) -> None:
    (tmp_path / "demo_01").mkdir()
    (tmp_path / "demo_01" / "precious").write_text("data")
    with pytest.raises(FileExistsError, match="demo_01 exists"):
        BagRecorder(ros_node, TOPICS).start(tmp_path, "demo_01")
    assert (tmp_path / "demo_01" / "precious").read_text() == "data"


def test_who_publishes_later_and_keeps_nothing_is_recorded_beside_what_was_said_once(
    ros_node: Node, tmp_path: Path
) -> None:
    once = ros_node.create_publisher(PoseStamped, "hand/pose", LATCHED)
    first = PoseStamped()
    first.header.frame_id, first.pose.position.x = "base", 100.0
    once.publish(first)
    with BagRecorder(ros_node, TOPICS).into(tmp_path / "demo") as recorder:
        spin_until(ros_node, lambda: recorder.counts["hand/pose"] == 1, message="what was said once")
        send(ros_node, recorder, 3)
    assert recorded(tmp_path / "demo") == [100.0, 0.0, 1.0, 2.0]
