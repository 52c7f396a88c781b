# SPDX-License-Identifier: Apache-2.0
"""frame_tracker with each source of frames that task files name, and with faults of a source, on its topics."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from ros_graph import ALL_LATCHED, SECOND, Diagnostics, Inbox, ros_arguments
from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_core.observation.poses import FAR
from tpgmm_msgs.msg import TaskFrame, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM, TRANSFORMS_STATIC

tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not built here: run 'make setup'")
vision_msgs = pytest.importorskip("vision_msgs.msg", reason="vision_msgs is not built here: run 'make setup'")

TASK = """\
name: sources
base_frame: base
movement: hand/pose
endpoint: left
frames:
  stamped: {topic: stamped}
  covariance: {topic: covariance, type: geometry_msgs/PoseWithCovarianceStamped}
  covariance_of_camera: {topic: covariance_of_camera, type: geometry_msgs/PoseWithCovarianceStamped}
  transform: {topic: transform, type: geometry_msgs/TransformStamped, child: cup}
  odometry: {topic: odometry, type: nav_msgs/Odometry}
  detection: {topic: seen, type: vision_msgs/Detection3DArray, class: cup}
  number: {topic: seen, type: vision_msgs/Detection3DArray, id: "7"}
  chain: {tf: cup}
  table: {tf: {frame: table, parent: world}}
  camera: {topic: from_camera}
  flipping: {topic: flipping}
"""
GOOD = np.array([0.6, 0.4, 0.1, *quaternion.exp([0.1, -0.2, 0.6])])
OTHER = np.array([0.1, -0.4, 0.2, *quaternion.exp([0.0, 0.0, 0.3])])
CAMERA = np.array([1.0, 0.2, 1.5, *quaternion.exp([0.3, 2.5, 0.4])])
COVARIANCE = np.diag([1e-4, 4e-4, 9e-4, 0.01, 0.02, 0.03])
TABLE = np.array([0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0])


def transform(pose: np.ndarray, stamp: int, parent: str, child: str) -> TransformStamped:
    message = TransformStamped(header=conversions.header_at(stamp, parent), child_frame_id=child)
    message.transform.translation = Vector3(**dict(zip("xyz", map(float, pose[:3]), strict=True)))
    message.transform.rotation = conversions.pose_from_array(pose).orientation
    return message


class World:
    """Publishes all things at 30 Hz, by all sources."""

    def __init__(self, node: Node) -> None:
        self._node, self._step = node, 0
        kinds = {
            "stamped": PoseStamped,
            "covariance": PoseWithCovarianceStamped,
            "covariance_of_camera": PoseWithCovarianceStamped,
            "transform": TransformStamped,
            "odometry": Odometry,
            "seen": vision_msgs.Detection3DArray,
            "from_camera": PoseStamped,
            "flipping": PoseStamped,
            "/tf": tf2_msgs.TFMessage,
        }
        self._to = {topic: node.create_publisher(kind, topic, STREAM) for topic, kind in kinds.items()}
        static = node.create_publisher(tf2_msgs.TFMessage, "/tf_static", TRANSFORMS_STATIC)
        static.publish(
            tf2_msgs.TFMessage(
                transforms=[transform(CAMERA, 0, "base", "camera"), transform(TABLE, 0, "/world", "table")]
            )
        )
        self._timer = node.create_timer(1 / 30, self._publish)

    def _publish(self) -> None:
        stamp, to = self._node.get_clock().now().nanoseconds, self._to
        self._step += 1
        header, pose = conversions.header_at(stamp, "base"), conversions.pose_from_array(GOOD)
        slashed = conversions.header_at(stamp, "/base")
        to["stamped"].publish(PoseStamped(header=slashed, pose=pose))
        message = PoseWithCovarianceStamped(header=header)
        message.pose.pose, message.pose.covariance = pose, COVARIANCE.ravel()
        to["covariance"].publish(message)
        message.header = conversions.header_at(stamp, "camera")
        message.pose.pose = conversions.pose_from_array(compose(inverse(CAMERA), GOOD))
        to["covariance_of_camera"].publish(message)
        to["transform"].publish(transform(OTHER, stamp, "base", "plate"))
        to["transform"].publish(transform(GOOD, stamp, "base", "cup"))
        odometry = Odometry(header=header, child_frame_id="cup")
        odometry.pose.pose = pose
        to["odometry"].publish(odometry)
        to["seen"].publish(self._seen(stamp))
        to["/tf"].publish(
            tf2_msgs.TFMessage(transforms=[transform(compose(inverse(CAMERA), GOOD), stamp, "camera", "cup")])
        )
        to["from_camera"].publish(conversions.pose_stamped(compose(inverse(CAMERA), GOOD), stamp, "camera"))
        turned = np.concatenate([GOOD[:3], quaternion.multiply(GOOD[3:], quaternion.exp([0.0, 0.0, np.pi]))])
        to["flipping"].publish(
            conversions.pose_stamped(turned if self._step > 30 and self._step % 4 == 3 else GOOD, stamp, "base")
        )

    def _seen(self, stamp: int) -> object:
        array = vision_msgs.Detection3DArray(header=conversions.header_at(stamp, "base"))
        for kind, number, score, place in (("cup", "1", 0.9, GOOD), ("cup", "2", 0.4, OTHER), ("mug", "7", 0.3, OTHER)):
            result = vision_msgs.ObjectHypothesisWithPose()
            result.hypothesis.class_id, result.hypothesis.score = kind, score
            result.pose.pose = conversions.pose_from_array(place)
            array.detections.append(vision_msgs.Detection3D(results=[result], id=number))
        return array


@pytest.fixture(scope="module")
def tracker(start_module_process: StartProcess, tmp_path_factory: pytest.TempPathFactory) -> RunningProcess:
    path = tmp_path_factory.mktemp("task") / "task.yaml"
    path.write_text(TASK)
    return start_module_process("frame_tracker", *ros_arguments(task_file=path))


@pytest.fixture(scope="module")
def world(module_node: Node, tracker: RunningProcess) -> Iterator[World]:
    yield World(module_node)


@pytest.fixture(scope="module")
def frame(module_node: Node, tracker: RunningProcess, world: World) -> Callable[[str], TaskFrame]:
    inbox = Inbox(module_node, TaskParameters, "task_parameters", ALL_LATCHED)

    def seen(name: str) -> TaskFrame:
        def found() -> TaskFrame | None:
            frames = inbox.last.frames if inbox.last is not None else ()
            return next((item for item in frames if item.name == name and item.status == TaskFrame.VISIBLE), None)

        spin_until(module_node, found, message=f"the frame {name}", processes=(tracker,))
        item = found()
        assert item is not None
        return item

    return seen


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        *(
            (name, GOOD)
            for name in (
                "stamped",
                "covariance",
                "covariance_of_camera",
                "transform",
                "odometry",
                "detection",
                "chain",
                "camera",
            )
        ),
        ("number", OTHER),
        ("table", TABLE),
    ],
)
def test_each_source_gives_the_frame(name: str, expected: np.ndarray, frame: Callable[[str], TaskFrame]) -> None:
    item = frame(name)
    np.testing.assert_allclose(item.b[:3], expected[:3], atol=1e-9)
    np.testing.assert_allclose(np.reshape(item.a, (7, 7))[:3, :3], quaternion.rotation_matrix(expected[3:]), atol=1e-9)


def test_a_covariance_goes_along_about_the_axes_of_the_base(frame: Callable[[str], TaskFrame]) -> None:
    np.testing.assert_allclose(np.reshape(frame("covariance").pose_covariance, (6, 6)), COVARIANCE, atol=1e-15)
    R = np.kron(np.eye(2), quaternion.rotation_matrix(CAMERA[3:]))
    seen = np.reshape(frame("covariance_of_camera").pose_covariance, (6, 6))
    np.testing.assert_allclose(seen, R @ COVARIANCE @ R.T, atol=1e-12)
    assert len(frame("stamped").pose_covariance) == len(frame("odometry").pose_covariance) == 0, "they say none"


def test_flips_are_refused_and_counted_with_rate_age_and_noise(
    module_node: Node, tracker: RunningProcess, frame: Callable[[str], TaskFrame]
) -> None:
    diagnostics = Diagnostics(module_node)
    rotation = quaternion.rotation_matrix(GOOD[3:])

    def values() -> dict[str, str]:
        return diagnostics.values.get("frame_tracker", {})

    right: deque[bool] = deque(maxlen=100)

    def refused_enough() -> bool:
        right.append(bool(np.allclose(np.reshape(frame("flipping").a, (7, 7))[:3, :3], rotation, atol=1e-9)))
        # each fourth pose is a flipped one; the first that came may be one, and after a pause of a busy machine a frame
        # may have turned: the right side wins in the end
        refused = int(values().get("refused_flipping: flip", 0))
        return refused >= 5 and len(right) == right.maxlen and bool(np.mean(right) > 0.9)

    spin_until(module_node, refused_enough, message="refused flips", processes=(tracker,))

    def refused_others() -> dict[str, str]:
        return {key: value for key, value in values().items() if key.startswith("refused_") and "flipping" not in key}

    # the first poses of another frame make the tracker listen to transforms, and are refused; no more are
    before, ticks = refused_others(), int(values()["ticks_done"])
    assert {key.split(":")[0] for key in before} <= {"refused_camera", "refused_covariance_of_camera"}
    spin_until(module_node, lambda: int(values()["ticks_done"]) > ticks + 100, message="more diagnostics")
    assert refused_others() == before
    spin_until(module_node, lambda: "rate_stamped_hz" in values(), message="the rate", processes=(tracker,))
    assert 0.0 < float(values()["rate_stamped_hz"]) < 100.0
    assert 0.0 <= float(values()["age_chain_s"])
    assert values()["noise_stamped"].endswith("deg")


def test_a_frame_that_stays_is_held_where_it_was_and_another_one_is_missing(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    frames = "frames: {table: {topic: table, unseen: stays}, cup: {topic: cup}}\ntracking: {hold_time: 0.1}\n"
    (tmp_path / "task.yaml").write_text(TASK.split("frames:")[0] + frames)
    process = start_process("frame_tracker", *ros_arguments(task_file=tmp_path / "task.yaml"))
    inbox = Inbox(ros_node, TaskParameters, "task_parameters", ALL_LATCHED)
    publishers = [ros_node.create_publisher(PoseStamped, name, STREAM) for name in ("table", "cup")]

    def statuses() -> list[int]:
        return [item.status for item in inbox.last.frames] if inbox.last is not None else []

    def seen() -> bool:
        for publisher in publishers:
            publisher.publish(conversions.pose_stamped(GOOD, ros_node.get_clock().now().nanoseconds, "base"))
        return statuses() == [TaskFrame.VISIBLE, TaskFrame.VISIBLE]

    spin_until(ros_node, seen, message="both frames", processes=(process,))
    held = [TaskFrame.HELD, TaskFrame.MISSING]
    spin_until(ros_node, lambda: statuses() == held, message="the cup to be missing", processes=(process,))
    table = inbox.last.frames[0]
    assert table.confidence == 1.0 and len(table.pose_covariance) == 0
    np.testing.assert_allclose(table.b[:3], GOOD[:3], atol=1e-9)


def test_a_frame_that_was_seen_to_move_with_the_hand_goes_on_with_it_and_one_beside_it_stays(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    carried = "{topic: %s, unseen: {with: hand}}"
    frames = f"frames: {{cup: {carried % 'cup'}, box: {carried % 'box'}}}\n"
    (tmp_path / "task.yaml").write_text(TASK.split("frames:")[0] + frames)
    process = start_process("frame_tracker", *ros_arguments(task_file=tmp_path / "task.yaml"))
    inbox = Inbox(ros_node, TaskParameters, "task_parameters", ALL_LATCHED)
    names = "hand/pose", "cup", "box"
    publishers = {name: ros_node.create_publisher(PoseStamped, name, STREAM) for name in names}
    in_hand, way = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]), [0.0]
    published, first_seen = [0], []

    def live(*seen: str) -> None:
        """The hand goes on by 2 mm, at most every 5 ms; what is seen is published with the hand."""
        stamp = ros_node.get_clock().now().nanoseconds
        if stamp - published[0] < SECOND // 200:
            return
        published[0] = stamp
        way[0] += 0.002
        hand = GOOD + np.array([way[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        places = {"hand/pose": hand, "cup": compose(hand, in_hand), "box": compose(GOOD, in_hand)}
        for name in ("hand/pose", *seen):
            publishers[name].publish(conversions.pose_stamped(places[name], stamp, "base"))

    def latest(name: str) -> Any:
        return next((item for item in inbox.last.frames if item.name == name), None) if inbox.last else None

    def carried_far() -> bool:
        live("cup", "box")
        cup = latest("cup")
        if cup is None or cup.status != TaskFrame.VISIBLE:
            return False
        first_seen.append(cup.b[0])
        return cup.b[0] - first_seen[0] > 0.1

    spin_until(ros_node, carried_far, message="the cup on its way", processes=(process,))
    last = way[0]

    def gone_on() -> bool:
        live()
        return way[0] > last + 0.1 and all(latest(name).status == TaskFrame.HELD for name in ("cup", "box"))

    spin_until(ros_node, gone_on, message="both frames to be held", processes=(process,))
    cup, box = latest("cup"), latest("box")
    np.testing.assert_allclose(cup.b[1:3], compose(GOOD, in_hand)[1:3], atol=1e-6)
    gone = cup.b[0] - compose(GOOD, in_hand)[0] - last
    assert np.sqrt(cup.pose_covariance[0]) == pytest.approx(0.01 + 0.1 * gone, rel=0.1) and gone > 0.05
    np.testing.assert_allclose(box.b[:3], compose(GOOD, in_hand)[:3], atol=1e-6)
    assert len(box.pose_covariance) == 0


def test_what_a_gripper_closes_around_unseen_goes_with_the_hand_until_it_opens(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    gripper = '{topic: fingers, type: sensor_msgs/JointState, field: "position[finger]", below: 0.03}'
    frames = f"frames: {{nut: {{topic: nut, unseen: {{with: hand, gripper: {gripper}}}}}}}\n"
    (tmp_path / "task.yaml").write_text(TASK.split("frames:")[0] + frames)
    process = start_process("frame_tracker", *ros_arguments(task_file=tmp_path / "task.yaml"))
    inbox = Inbox(ros_node, TaskParameters, "task_parameters", ALL_LATCHED)
    diagnostics = Diagnostics(ros_node)
    hands, nuts = (ros_node.create_publisher(PoseStamped, name, STREAM) for name in ("hand/pose", "nut"))
    fingers = ros_node.create_publisher(JointState, "fingers", STREAM)
    nut = GOOD + np.array([0.0, 0.04, 0.0, 0.0, 0.0, 0.0, 0.0])
    way, width, published = [0.0], [0.08], [0]

    def live(speed: float, *seen: np.ndarray) -> None:
        """The hand goes on by so many m, at most every 5 ms."""
        stamp = ros_node.get_clock().now().nanoseconds
        if stamp - published[0] < SECOND // 200:
            return
        published[0] = stamp
        way[0] += speed
        hand = GOOD + np.array([way[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        hands.publish(conversions.pose_stamped(hand, stamp, "base"))
        fingers.publish(conversions.joint_state_message(["wrist", "finger"], stamp, np.array([0.0, width[0]])))
        for pose in seen:
            nuts.publish(conversions.pose_stamped(pose, stamp, "base"))

    def is_there(x: float, status: int, speed: float, *seen: np.ndarray) -> Callable[[], bool]:
        def check() -> bool:
            live(speed if way[0] < x - GOOD[0] else 0.0, *seen)
            found = next(iter(inbox.last.frames), None) if inbox.last else None
            return found is not None and found.status == status and abs(found.b[0] - x) < 1e-6

        return check

    def is_gone(x: float) -> Callable[[], bool]:
        def check() -> bool:
            live(0.002)
            return way[0] > x

        return check

    def says(words: str) -> Callable[[], bool]:
        def check() -> bool:
            live(0.0)
            return words in diagnostics.values.get("frame_tracker", {}).get("note_nut_1", "")

        return check

    def until(condition: Callable[[], bool], what: str) -> None:
        spin_until(ros_node, condition, message=what, processes=(process,))

    until(is_there(GOOD[0], TaskFrame.VISIBLE, 0.0, nut), "the nut")
    until(says("stays where it was: the gripper is open"), "the open gripper")
    width[0] = 0.01
    until(says("moves with the hand, whose gripper holds it"), "the closed gripper")
    last = way[0]
    until(is_gone(last + 0.1), "the hand's way")
    until(is_there(GOOD[0] + way[0], TaskFrame.HELD, 0.0), "the nut in the hand")
    width[0], let_go = 0.08, GOOD[0] + way[0]
    until(says("stays where the gripper let it go"), "the gripper to open")
    until(is_gone(last + 0.2), "the hand's further way")
    until(is_there(let_go, TaskFrame.HELD, 0.0), "the nut where it was let go")


def test_a_frame_that_no_transforms_lead_to_is_named_with_what_is_known(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    (tmp_path / "task.yaml").write_text(TASK.split("frames:")[0] + "frames: {mug: {tf: mug}}\n")
    process = start_process("frame_tracker", *ros_arguments(task_file=tmp_path / "task.yaml"))
    diagnostics = Diagnostics(ros_node)
    publisher = ros_node.create_publisher(tf2_msgs.TFMessage, "/tf", STREAM)

    def said() -> bool:
        stamp = ros_node.get_clock().now().nanoseconds
        publisher.publish(tf2_msgs.TFMessage(transforms=[transform(GOOD, stamp, "base", "cup")]))
        return "nothing connects 'base' to 'mug'; those that came are about base, cup" in diagnostics.messages.get(
            "frame_tracker", ""
        )

    spin_until(ros_node, said, message="the reason", processes=(process,))


def test_a_clock_that_is_ahead_and_lengths_that_are_odd_are_taken_and_said(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    (tmp_path / "task.yaml").write_text(TASK.split("frames:")[0] + "frames: {cup: {topic: cup}}\n")
    process = start_process("frame_tracker", *ros_arguments(task_file=tmp_path / "task.yaml"))
    diagnostics = Diagnostics(ros_node)
    publisher = ros_node.create_publisher(PoseStamped, "cup", STREAM)
    pose = np.concatenate([GOOD[:3] + 2 * FAR, 1.3 * GOOD[3:]])

    def publish() -> None:
        stamp = ros_node.get_clock().now().nanoseconds + round(0.15 * SECOND)
        publisher.publish(conversions.pose_stamped(pose, stamp, "base"))

    timer = ros_node.create_timer(1 / 30, publish)

    def said() -> bool:
        values = diagnostics.values.get("frame_tracker", {})
        notes = " ".join(text for key, text in values.items() if key.startswith("note_cup"))
        return values.get("status_cup") == "VISIBLE" and all(
            words in notes for words in ("ahead of ROS time", "not of length 1", "millimetres")
        )

    spin_until(ros_node, said, message="the notes", processes=(process,))
    ros_node.destroy_timer(timer)


def test_a_frame_that_is_missing_says_why_and_one_among_many_on_a_topic_is_seen(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    kind = "type: vision_msgs/Detection3DArray"
    frames = (
        f"{{silent: {{topic: silent}}, other: {{topic: other}}, mug: {{topic: seen, {kind}, class: mug}}, "
        "last: {topic: all, type: geometry_msgs/TransformStamped, child: t0}, foreign: {topic: foreign}}"
    )
    (tmp_path / "task.yaml").write_text(f"{TASK.split('frames:')[0]}frames: {frames}\n")
    process = start_process("frame_tracker", *ros_arguments(task_file=tmp_path / "task.yaml"))
    diagnostics = Diagnostics(ros_node)
    kinds: dict[str, type] = {
        "other": Odometry,
        "seen": vision_msgs.Detection3DArray,
        "all": TransformStamped,
        "foreign": PoseStamped,
    }
    to = {topic: ros_node.create_publisher(kind, topic, QoSProfile(depth=50)) for topic, kind in kinds.items()}

    def publish() -> None:
        stamp = ros_node.get_clock().now().nanoseconds
        to["other"].publish(Odometry())
        to["seen"].publish(vision_msgs.Detection3DArray(detections=[vision_msgs.Detection3D(id="1")]))
        for i in range(20):
            to["all"].publish(transform(GOOD, stamp, "base", f"t{i}"))
        to["foreign"].publish(conversions.pose_stamped(GOOD, stamp, "lens"))

    timer = ros_node.create_timer(1 / 30, publish)
    expected = (
        "frame 'silent': nobody publishes /silent",
        "/test is not heard on /other: it publishes nav_msgs/msg/Odometry, expected geometry_msgs/msg/PoseStamped",
        "messages on /seen holds class 'mug'",
        "frame 'foreign': wrong frame_id: 'lens', expected 'base'",
    )

    def said() -> bool:
        message, values = diagnostics.messages.get("frame_tracker", ""), diagnostics.values.get("frame_tracker", {})
        return values.get("status_last") == "VISIBLE" and all(words in message for words in expected)

    spin_until(ros_node, said, message="the reasons", processes=(process,))
    ros_node.destroy_timer(timer)
    assert all(words in process.output for words in ("is not heard on /other", "wrong frame_id: 'lens'"))
