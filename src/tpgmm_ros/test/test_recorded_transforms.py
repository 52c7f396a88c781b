# SPDX-License-Identifier: Apache-2.0
"""Transforms in bags: what /tf and /tf_static say of frames and of poses in other frames, and what they leave open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from source_messages import TYPES, of_type, pose_stamped, task_with, transform, write
from synthetic_bags import REACH_TASK, START_S, reach
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_ros.programs import inspect
from tpgmm_ros.recordings.bags import BagError, read_recording

CAMERA = np.array([1.0, 0.2, 1.5, *quaternion.exp([0.3, 2.5, 0.4])])


@pytest.mark.parametrize("is_static", [True, False])
def test_poses_in_a_cameras_frame_are_transformed_by_what_the_bag_holds(is_static: bool, tmp_path: Path) -> None:
    topics = reach(0)
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    tf = TYPES["tf2_msgs/msg/TFMessage"]
    cameras = np.tile(CAMERA, (100, 1))
    if not is_static:
        cameras[:, 1] += np.linspace(0.0, 0.5, 100)
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    for camera, pose, t in zip(cameras, thing.poses, thing.recorded, strict=True):
        seen = compose(inverse(camera), pose)
        messages.append((t, "/object/pose", "geometry_msgs/msg/PoseStamped", pose_stamped(seen, t, "camera")))
        if not is_static or t == 0.0:
            topic = "/tf_static" if is_static else "/tf"
            messages.append((t, topic, "tf2_msgs/msg/TFMessage", tf(transforms=[transform(camera, t, "camera")])))
    recording = read_recording(write(tmp_path / "demo", messages), task_with())
    np.testing.assert_allclose(recording.frames["object"][:, :3], thing.poses[:, :3], atol=1e-9)
    assert recording.notes == ("/object/pose: 100 poses in 'camera' transformed to 'base' by /tf",)


def test_transforms_without_stamps_have_the_times_of_the_recorder(tmp_path: Path) -> None:
    topics = reach(0)
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    messages = of_type("tf", "", hand.poses, hand.recorded, "hand")
    messages += of_type("tf", "", thing.poses, hand.recorded, "cup")
    for message in messages:
        message[3].transforms[0].header.stamp = TYPES["builtin_interfaces/msg/Time"](0, 0)
    task = task_with(object={"tf": "cup"}, movement={"tf": "hand"})
    recording = read_recording(write(tmp_path / "demo", messages), task)
    np.testing.assert_allclose(recording.movement, hand.poses, atol=1e-12)
    assert recording.notes == ("/tf has stamps that never change: times of the recorder used",)


def test_a_frame_behind_static_transforms_alone_is_fixed(tmp_path: Path) -> None:
    hand = reach(0)["/endpoint/pose"]
    tf = TYPES["tf2_msgs/msg/TFMessage"]
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    static = tf(transforms=[transform(CAMERA, 0.0, "table", "world"), transform(hand.poses[0], 0.0, "base", "world")])
    messages.append((3.0, "/tf_static", "tf2_msgs/msg/TFMessage", static))
    recording = read_recording(write(tmp_path / "demo", messages), task_with(object={"tf": "table"}))
    expected = compose(inverse(hand.poses[0]), CAMERA)
    np.testing.assert_allclose(recording.frames["object"], np.tile(expected, (100, 1)), atol=1e-12)
    assert recording.visible["object"].all()


@pytest.mark.parametrize("moves", [True, False])
def test_a_place_that_is_told_twice_otherwise_is_doubted(moves: bool, tmp_path: Path) -> None:
    topics, tf = reach(0), TYPES["tf2_msgs/msg/TFMessage"]
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    if moves:
        seen = compose(inverse(CAMERA), thing.poses)
        for t, pose in zip(thing.recorded, seen, strict=True):
            messages.append((t, "/object/pose", "geometry_msgs/msg/PoseStamped", pose_stamped(pose, t, "camera")))
    for at, shift in ((0.0, 0.0), (2.0, 0.3)):
        place = CAMERA + [shift, 0, 0, 0, 0, 0, 0]
        both = [transform(place, at, "camera"), transform(place, at, "of_another_robot")]
        messages.append((at, "/tf_static", "tf2_msgs/msg/TFMessage", tf(transforms=both)))
    task = task_with() if moves else task_with(object={"tf": "camera"})
    path = write(tmp_path / "demo", messages)
    recording = read_recording(path, task)
    assert not [note for note in recording.notes if "static transform" in note]
    (doubt,) = recording.doubts
    assert doubt.kind == "transforms" and not doubt.refuses
    assert "/tf_static: 'camera' has a static transform and another one" in doubt.text
    assert "0.300 m and 0.0 deg apart: the last one counts" in doubt.text
    (tmp_path / "task.yaml").write_text(
        REACH_TASK if moves else REACH_TASK.replace("{topic: object/pose}", "{tf: camera}")
    )
    arguments = ["--task", str(tmp_path / "task.yaml"), str(path)]
    assert inspect.main(arguments) == 0 and inspect.main(["--strict", *arguments]) == 1


def test_a_frame_that_is_in_another_tree_since_it_was_told_twice_names_this_as_the_cause(tmp_path: Path) -> None:
    hand, tf = reach(0)["/endpoint/pose"], TYPES["tf2_msgs/msg/TFMessage"]
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    for at, parent in ((0.0, "base"), (2.0, "world")):
        static = tf(transforms=[transform(CAMERA, at, "camera", parent)])
        messages.append((at, "/tf_static", "tf2_msgs/msg/TFMessage", static))
    with pytest.raises(BagError, match="nothing connects 'base' to 'camera'.*; 'camera' has a static transform and"):
        read_recording(write(tmp_path / "demo", messages), task_with(object={"tf": "camera"}))


def test_transforms_of_a_ros_1_before_tf2_are_read(tmp_path: Path) -> None:
    topics, store, kind = reach(0), get_typestore(Stores.ROS1_NOETIC), "tf/msg/tfMessage"
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    with Ros1Writer(tmp_path / "demo.bag") as writer:
        connection = writer.add_connection("/tf", kind, typestore=store)
        for i, t in enumerate(hand.recorded):
            items = [transform(hand.poses[i], t, "hand"), transform(thing.poses[i], t, "cup")]
            for item in items:
                item.header = store.types["std_msgs/msg/Header"](seq=i, stamp=item.header.stamp, frame_id="/base")
            raw = store.serialize_ros1(store.types[kind](transforms=items), kind)
            writer.write(connection, int(START_S) * 10**9 + round(t * 1e9), raw)
    recording = read_recording(tmp_path / "demo.bag", task_with(object={"tf": "cup"}, movement={"tf": "hand"}))
    np.testing.assert_allclose(recording.movement, hand.poses, atol=1e-12)
    np.testing.assert_allclose(recording.frames["object"], thing.poses, atol=1e-12)


def test_transforms_of_several_robots_are_told_apart_by_nobody(tmp_path: Path) -> None:
    topics, tf = reach(0), TYPES["tf2_msgs/msg/TFMessage"]
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    for t, pose in zip(thing.recorded, thing.poses, strict=True):
        for robot in ("/left/tf", "/right/tf"):
            messages.append((t, robot, "tf2_msgs/msg/TFMessage", tf(transforms=[transform(pose, t, "cup")])))
    with pytest.raises(BagError, match="transforms of several robots, on /left/tf, /right/tf, and a task file cannot"):
        read_recording(write(tmp_path / "demo", messages), task_with(object={"tf": "cup"}))


def test_a_transform_that_came_once_on_tf_belongs_on_tf_static(tmp_path: Path) -> None:
    topics, tf = reach(0), TYPES["tf2_msgs/msg/TFMessage"]
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    messages.append((0.0, "/tf", "tf2_msgs/msg/TFMessage", tf(transforms=[transform(CAMERA, 0.0, "camera")])))
    for t, pose in zip(thing.recorded, thing.poses, strict=True):
        messages.append((t, "/object/pose", "geometry_msgs/msg/PoseStamped", pose_stamped(pose, t, "camera")))
    with pytest.raises(BagError, match="after its last sample. Publish that transform all the time, or on /tf_static"):
        read_recording(write(tmp_path / "demo", messages), task_with())
