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

from source_messages import (
    COVARIANCE,
    TYPES,
    detections,
    header,
    odometry,
    of_type,
    pose_of,
    pose_stamped,
    task_with,
    transform,
    with_covariance,
    write,
)
from synthetic_bags import REACH_TASK, START_S, reach, write_bag
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.tracking import FrameTracker
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
