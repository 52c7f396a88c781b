# SPDX-License-Identifier: Apache-2.0
"""Sources of poses: each gives the same from live messages and from bags, and a task is learned from any of them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from synthetic_bags import REACH_TASK, START_S, reach, write_bag
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_core.observation.tracking import FrameTracker
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages.sources import (
    DetectionSource,
    OdometrySource,
    PoseStampedSource,
    PoseWithCovarianceStampedSource,
    TopicSource,
    TransformStampedSource,
)
from tpgmm_ros.recordings.bags import BagError, read_recording
from tpgmm_ros.task.task_file import Task, TaskError

CONFIG = Path(__file__).resolve().parents[3] / "config"
DETECTIONS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
for name, definition in DETECTIONS.items():
    TYPESTORE.register(get_types_from_msg(definition, name))
TYPES = TYPESTORE.types
Message = tuple[float, str, str, Any]
COVARIANCE = np.diag([1e-4, 4e-4, 1e-4, 1e-2, 1e-2, 1e-2])


# messages as rosbags has them


def header(seconds: float, frame_id: str = "base") -> Any:
    ns = int(START_S) * 10**9 + round(seconds * 1e9)
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def vector(kind: str, numbers: NDArray[np.float64]) -> Any:
    return TYPES[f"geometry_msgs/msg/{kind}"](*map(float, numbers))


def pose_of(numbers: NDArray[np.float64]) -> Any:
    return TYPES["geometry_msgs/msg/Pose"](
        position=vector("Point", numbers[:3]), orientation=vector("Quaternion", numbers[3:])
    )


def with_covariance(numbers: NDArray[np.float64]) -> Any:
    return TYPES["geometry_msgs/msg/PoseWithCovariance"](pose=pose_of(numbers), covariance=COVARIANCE.ravel())


def pose_stamped(numbers: NDArray[np.float64], at: float, frame_id: str = "base") -> Any:
    return TYPES["geometry_msgs/msg/PoseStamped"](header=header(at, frame_id), pose=pose_of(numbers))


def transform(numbers: NDArray[np.float64], at: float, child: str, parent: str = "base") -> Any:
    moved = TYPES["geometry_msgs/msg/Transform"](
        translation=vector("Vector3", numbers[:3]), rotation=vector("Quaternion", numbers[3:])
    )
    return TYPES["geometry_msgs/msg/TransformStamped"](header=header(at, parent), child_frame_id=child, transform=moved)


def odometry(numbers: NDArray[np.float64], at: float) -> Any:
    zero = np.zeros(3)
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector("Vector3", zero), angular=vector("Vector3", zero))
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(at),
        child_frame_id="hand",
        pose=with_covariance(numbers),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )


def detections(at: float, **seen: tuple[float, NDArray[np.float64]]) -> Any:
    """Detections of classes with scores; the tracking id is the class with an underscore."""
    found = []
    for kind, (score, numbers) in seen.items():
        hypothesis = TYPES["vision_msgs/msg/ObjectHypothesis"](class_id=kind.split("_")[0], score=score)
        result = TYPES["vision_msgs/msg/ObjectHypothesisWithPose"](hypothesis=hypothesis, pose=with_covariance(numbers))
        box = TYPES["vision_msgs/msg/BoundingBox3D"](center=pose_of(numbers), size=vector("Vector3", np.ones(3)))
        found.append(TYPES["vision_msgs/msg/Detection3D"](header=header(at, ""), results=[result], bbox=box, id=kind))
    return TYPES["vision_msgs/msg/Detection3DArray"](header=header(at), detections=found)


def write(path: Path, messages: list[Message]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=TYPESTORE)
            for topic, kind in dict.fromkeys((topic, kind) for _, topic, kind, _ in messages)
        }
        for at, topic, kind, message in sorted(messages, key=lambda item: item[0]):
            ns = int(START_S) * 10**9 + round(at * 1e9)
            writer.write(connections[topic], ns, TYPESTORE.serialize_cdr(message, kind))
    return path


def of_type(kind: str, topic: str, poses: NDArray[np.float64], times: NDArray[np.float64], child: str) -> list[Message]:
    """The poses of one thing, as messages of a type."""
    if kind == "tf":
        tf = TYPES["tf2_msgs/msg/TFMessage"]
        return [
            (t, "/tf", "tf2_msgs/msg/TFMessage", tf(transforms=[transform(pose, t, child)]))
            for pose, t in zip(poses, times, strict=True)
        ]
    make = {
        "geometry_msgs/PoseStamped": pose_stamped,
        "geometry_msgs/TransformStamped": lambda pose, t: transform(pose, t, child),
        "geometry_msgs/PoseWithCovarianceStamped": lambda pose, t: TYPES["geometry_msgs/msg/PoseWithCovarianceStamped"](
            header=header(t), pose=with_covariance(pose)
        ),
        "nav_msgs/Odometry": odometry,
        "vision_msgs/Detection3DArray": lambda pose, t: detections(t, **{child: (0.9, pose), "other": (1.0, -pose)}),
    }[kind]
    return [(t, topic, kind.replace("/", "/msg/"), make(pose, t)) for pose, t in zip(poses, times, strict=True)]


def task_with(**entries: Any) -> Task:
    """The reach, with other entries of the frame `object` and of the recorded movement."""
    task = yaml.safe_load(REACH_TASK)
    if "object" in entries:
        task["frames"]["object"] = entries["object"]
    if "movement" in entries:
        task["recordings"] = {"movement": entries["movement"]}
    return Task.from_text(yaml.safe_dump(task))


ENTRIES: dict[str, dict[str, Any]] = {
    "geometry_msgs/PoseStamped": {},
    "geometry_msgs/PoseWithCovarianceStamped": {},
    "geometry_msgs/TransformStamped": {"child": "{}"},
    "nav_msgs/Odometry": {},
    "vision_msgs/Detection3DArray": {"class": "{}"},
}


@pytest.mark.parametrize("kind", [*ENTRIES, "tf"])
def test_hand_and_object_are_read_from_any_source(kind: str, tmp_path: Path) -> None:
    topics = reach(0)
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    thing.poses[:, 0] += np.linspace(0.0, 0.3, 100)
    messages = of_type(kind, "/endpoint/pose", hand.poses, hand.recorded, "hand")
    messages += of_type(kind, "/object/pose", thing.poses, thing.recorded, "cup")

    def entry(topic: str, child: str) -> dict[str, Any]:
        if kind == "tf":
            return {"tf": child}
        return {"topic": topic, "type": kind} | {key: text.format(child) for key, text in ENTRIES[kind].items()}

    task = task_with(object=entry("object/pose", "cup"), movement=entry("endpoint/pose", "hand"))
    recording = read_recording(write(tmp_path / "demo", messages), task)
    np.testing.assert_allclose(recording.times, hand.recorded, atol=1e-8)
    np.testing.assert_allclose(recording.movement, hand.poses, atol=1e-12)
    np.testing.assert_allclose(recording.frames["object"], thing.poses, atol=1e-12)
    assert not recording.notes and recording.visible["object"].all()


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


def test_a_movement_is_the_pose_of_a_link_by_the_robots_joints(tmp_path: Path) -> None:
    robot = RobotModel.from_file(CONFIG / "panda.yaml")
    data, joints = robot.create_data(), list(robot.joint_names)
    thing, times = reach(0)["/object/pose"], np.linspace(0.0, 5.0, 100)
    positions = robot.home + 0.3 * np.sin(times)[:, None] * np.arange(1, robot.nv + 1) / robot.nv
    messages = of_type("geometry_msgs/PoseStamped", "/object/pose", thing.poses, thing.recorded, "cup")
    kind = "sensor_msgs/msg/JointState"
    expected = []
    for q, t in zip(positions, times, strict=True):
        state = TYPES[kind](
            header(t, ""), [*joints[::-1], "finger"], np.append(q[::-1], 0.02), np.zeros(0), np.zeros(0)
        )
        messages.append((t, "/joint_states", kind, state))
        data.update(q)
        expected.append(data.pose("hand"))
    entry = {"joint_states": "joint_states", "robot": str(CONFIG / "panda.yaml"), "link": "hand"}
    task = task_with(movement=entry)
    path = write(tmp_path / "demo", messages)
    with pytest.raises(BagError, match="the task has 'base': name the same base_frame"):
        read_recording(path, task)
    for item in messages:
        if item[1] == "/object/pose":
            item[3].header.frame_id = "panda_link0"
    text = yaml.safe_dump(yaml.safe_load(REACH_TASK) | {"base_frame": "panda_link0", "recordings": {"movement": entry}})
    recording = read_recording(write(tmp_path / "right", messages), Task.from_text(text))
    np.testing.assert_allclose(recording.movement[:, :3], np.array(expected)[:, :3], atol=1e-9)
    np.testing.assert_allclose(
        quaternion.angle_between(recording.movement[:, 3:], np.array(expected)[:, 3:]), 0, atol=1e-6
    )
    assert not recording.doubts and not recording.notes
    states = [item[3].position for item in messages if item[1] == "/joint_states"]
    usual = states[40][0]
    states[40][0] = np.nan
    recording = read_recording(write(tmp_path / "gap", messages), Task.from_text(text))
    assert len(recording.times) == 99 and "1 of 100 messages left out, the first is number 40" in recording.notes[0]
    states[40][0] = usual + 9.0
    recording = read_recording(write(tmp_path / "beyond", messages), Task.from_text(text))
    assert any("the joint panda_joint7 is at" in doubt.text for doubt in recording.doubts)
    for position in states:
        position[:] = np.degrees(position)
    with pytest.raises(BagError, match="the joint panda_joint.* seems to be in degrees"):
        read_recording(write(tmp_path / "degrees", messages), Task.from_text(text))


def test_what_a_source_does_not_find_is_said(tmp_path: Path) -> None:
    topics = reach(0)
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    messages += of_type("vision_msgs/Detection3DArray", "/seen", thing.poses, thing.recorded, "cup")
    messages += of_type("tf", "", thing.poses, thing.recorded, "cup")
    path = write(tmp_path / "demo", messages)
    seen = {"topic": "seen", "type": "vision_msgs/Detection3DArray"}
    for entry, words in (
        ({**seen, "class": "mug"}, "/seen never holds class 'mug', in 100 messages"),
        ({**seen, "id": "7"}, "/seen never holds id '7'"),
        ({"tf": "mug"}, "nothing connects 'base' to 'mug'; those that came are about base, cup"),
        ({"tf": {"frame": "cup", "parent": "world"}}, "nothing connects 'world' to 'cup'"),
        ({"topic": "seen"}, "is of type vision_msgs/msg/Detection3DArray.* or name the type there"),
    ):
        with pytest.raises(BagError, match=words):
            read_recording(path, task_with(object=entry))


def test_tags_that_flip_are_left_out_and_said(tmp_path: Path) -> None:
    topics = reach(0)
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    bad = np.random.default_rng(1).random(100) < 0.2
    bad[80:] = True
    flipped = quaternion.multiply(thing.poses[:, 3:], quaternion.exp([0.0, 0.0, np.pi]))
    spoilt = np.hstack([thing.poses[:, :3], np.where(bad[:, None], flipped, thing.poses[:, 3:])])
    kind = "geometry_msgs/PoseStamped"
    messages = of_type(kind, "/endpoint/pose", hand.poses, hand.recorded, "")
    recording = read_recording(
        write(tmp_path / "demo", messages + of_type(kind, "/object/pose", spoilt, thing.recorded, "")), task_with()
    )
    angles = quaternion.angle_between(recording.frames["object"][:, 3:], thing.poses[:, 3:])
    np.testing.assert_allclose(angles, 0.0, atol=1e-6)
    assert len(recording.notes) == 1
    assert f"/object/pose: {bad.sum()} of 100 poses leap by up to 0.000 m and 180 deg" in recording.notes[0]


def test_two_things_by_turns_on_one_topic_are_refused(tmp_path: Path) -> None:
    topics = reach(0)
    topics["/object/pose"].poses[::2, :3] += [0.3, 0.1, 0.0]
    with pytest.raises(BagError, match="50 of 100 poses leap by up to 0.316 m.* or two things are on one topic"):
        read_recording(write_bag(tmp_path / "demo", topics), task_with())


# the same code reads live messages


def test_live_messages_and_those_of_bags_are_read_alike() -> None:
    numbers = np.array([0.1, -0.2, 0.3, *quaternion.exp([0.3, 0.2, -0.1])])

    def filled(message: Any, like: Any) -> Any:
        """A message of rclpy with the values of one of rosbags."""
        for name in message.get_fields_and_field_types():
            value, own = getattr(like, name), getattr(message, name)
            setattr(message, name, filled(own, value) if hasattr(own, "get_fields_and_field_types") else value)
        return message

    pairs: list[tuple[TopicSource, Any, Any]] = [
        (PoseStampedSource("a"), PoseStamped(), pose_stamped(numbers, 1.5)),
        (TransformStampedSource("a", "cup"), TransformStamped(), transform(numbers, 1.5, "/cup")),
        (OdometrySource("a"), Odometry(), odometry(numbers, 1.5)),
        (
            PoseWithCovarianceStampedSource("a"),
            PoseWithCovarianceStamped(),
            TYPES["geometry_msgs/msg/PoseWithCovarianceStamped"](header=header(1.5), pose=with_covariance(numbers)),
        ),
    ]
    for source, live, recorded in pairs:
        expected, found = source.read(recorded), source.read(filled(live, recorded))
        assert expected is not None and found is not None
        assert found[:2] == expected[:2] == (int(START_S) * 10**9 + 1_500_000_000, "base")
        np.testing.assert_array_equal(found.pose, numbers)
        np.testing.assert_array_equal(expected.pose, numbers)
        if "Covariance" in str(type(live)) or isinstance(live, Odometry):
            np.testing.assert_array_equal(found.covariance, COVARIANCE)


def test_the_surest_detection_of_a_class_is_taken_or_that_with_an_id() -> None:
    a, b, c = np.eye(7)[6] + 1.0, np.eye(7)[6] + 2.0, np.eye(7)[6] + 3.0
    message = detections(2.0, cup_1=(0.6, a), cup_2=(0.8, b), mug=(0.9, c))
    for source, expected in (
        (DetectionSource("d", class_id="cup"), b),
        (DetectionSource("d", tracking_id="cup_1"), a),
        (DetectionSource("d", class_id="cup", min_score=0.85), None),
        (DetectionSource("d", class_id="mug", tracking_id="cup_1"), None),
    ):
        found = source.read(message)
        assert (found is None) is (expected is None)
        if found is not None:
            np.testing.assert_array_equal(found.pose, expected)
            assert found.frame_id == "base", "a detection without a header has that of the array"


def test_a_covariance_that_is_none_is_not_handed_on() -> None:
    pose = SimpleNamespace(pose=pose_of(np.eye(7)[6]), covariance=np.zeros(36))
    source = PoseWithCovarianceStampedSource("a")
    unknown = np.zeros(36)
    unknown[0] = -1.0
    negative = np.diag([-1e-4, *[1e-4] * 5]).ravel()
    for given, is_none in ((np.zeros(36), True), (unknown, True), (np.full(36, np.nan), False), (negative, False)):
        pose.covariance = given
        found = source.read(SimpleNamespace(header=header(0.0), pose=pose))
        assert found is not None
        tracker = FrameTracker(["cup"])
        assert tracker.observe("cup", found.pose, 10**9, 10**9, 10**9, found.covariance) is None
        (frame,) = tracker.update(10**9)
        assert frame.covariance is None and (found.covariance is None) is is_none
        assert ("1 covariances are none" in " ".join(tracker.health(10**9)["cup"].notes)) is not is_none


# entries of task files


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ({"topic": "a", "type": "std_msgs/String"}, r"'frames\.object\.type' is 'std_msgs/String', expected one of"),
        ({"topic": "a", "class": "cup"}, "has 'class', which is not a key of 'geometry_msgs/PoseStamped'"),
        ({"topic": "a", "type": "vision_msgs/Detection3DArray"}, "give the 'class' or the tracking 'id'"),
        ({"topic": "a", "type": "vision_msgs/msg/Detection3DArray", "id": 7}, "expected a text .in quotes"),
        ({"tf": "/cup"}, "without a leading slash"),
        ({"tf": {"frame": "cup", "base": "world"}}, "unknown key 'base'"),
        ({"tf": "cup", "type": "nav_msgs/Odometry"}, "has 'type', which is not a key of 'tf'"),
        ({"tf": "cup", "topic": "a"}, "needs exactly one of"),
        ({"type": "nav_msgs/Odometry"}, "needs exactly one of 'topic' or 'tf'"),
        ({"pose": [0, 0, 0, 0, 0, 0, 1], "child": "cup"}, "'child', which is for observed frames"),
    ],
)
def test_entries_that_name_no_source_are_refused(entry: dict[str, Any], complaint: str) -> None:
    with pytest.raises(TaskError, match=complaint):
        task_with(object=entry)


def test_frames_may_share_a_topic_that_tells_them_apart() -> None:
    task = yaml.safe_load(REACH_TASK)
    seen = {"topic": "seen", "type": "vision_msgs/Detection3DArray"}
    task["frames"] = {"cup": {**seen, "class": "cup"}, "plate": {**seen, "class": "plate"}}
    assert len(Task.from_text(yaml.safe_dump(task)).sources) == 2
    task["frames"]["plate"]["class"] = "cup"
    with pytest.raises(TaskError, match="already used by the frame 'cup'"):
        Task.from_text(yaml.safe_dump(task))


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ({"joint_states": "a", "robot": "panda.yaml"}, "lacks the key 'link'"),
        ({"joint_states": "a", "robot": "panda.yaml", "link": "hand", "tf": "hand"}, "unknown key 'tf'"),
        ({"pose": [0, 0, 0, 0, 0, 0, 1]}, "unknown key 'pose'"),
        ({}, "needs exactly one of 'topic', 'tf' and 'joint_states'"),
    ],
)
def test_recorded_movements_that_name_no_source_are_refused(entry: dict[str, Any], complaint: str) -> None:
    with pytest.raises(TaskError, match=complaint):
        task_with(movement=entry)


@pytest.mark.parametrize("moves", [True, False])
def test_a_place_that_is_told_twice_otherwise_is_said(moves: bool, tmp_path: Path) -> None:
    topics, tf = reach(0), TYPES["tf2_msgs/msg/TFMessage"]
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    messages = of_type("geometry_msgs/PoseStamped", "/endpoint/pose", hand.poses, hand.recorded, "hand")
    if moves:
        seen = compose(inverse(CAMERA), thing.poses)
        for t, pose in zip(thing.recorded, seen, strict=True):
            messages.append((t, "/object/pose", "geometry_msgs/msg/PoseStamped", pose_stamped(pose, t, "camera")))
    for at, shift in ((0.0, 0.0), (2.0, 0.3)):
        place = CAMERA + [shift, 0, 0, 0, 0, 0, 0]
        messages.append((at, "/tf_static", "tf2_msgs/msg/TFMessage", tf(transforms=[transform(place, at, "camera")])))
    task = task_with() if moves else task_with(object={"tf": "camera"})
    notes = read_recording(write(tmp_path / "demo", messages), task).notes
    said = [note for note in notes if "/tf_static: 'camera' has a static transform and another one" in note]
    assert len(said) == 1 and "0.300 m and 0.0 deg apart: the last one counts" in said[0]


@pytest.mark.parametrize("names", [1, 0])
def test_joint_states_that_name_their_joints_once_or_never_are_called_so(names: int, tmp_path: Path) -> None:
    robot, kind = RobotModel.from_file(CONFIG / "panda.yaml"), "sensor_msgs/msg/JointState"
    thing, none = reach(0)["/object/pose"], np.zeros(0)
    messages: list[Message] = [
        (t, "/object/pose", "geometry_msgs/msg/PoseStamped", pose_stamped(pose, t, robot.base_frame))
        for t, pose in zip(thing.recorded, thing.poses, strict=True)
    ]
    for i, t in enumerate(np.linspace(0.0, 5.0, 100)):
        state = TYPES[kind](header(t, ""), list(robot.joint_names) if i < names else [], robot.home, none, none)
        messages.append((t, "/joint_states", kind, state))
    entry = {"joint_states": "joint_states", "robot": str(CONFIG / "panda.yaml"), "link": "hand"}
    text = yaml.safe_dump(yaml.safe_load(REACH_TASK) | {"base_frame": "panda_link0", "recordings": {"movement": entry}})
    with pytest.raises(BagError, match=f"has {100 - names} of 100 messages.* it has 7 positions and names no joints"):
        read_recording(write(tmp_path / "demo", messages), Task.from_text(text))


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
