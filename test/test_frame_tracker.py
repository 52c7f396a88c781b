# SPDX-License-Identifier: Apache-2.0
"""frame_tracker on its topics: poses of all kinds in, task parameters out."""

from __future__ import annotations

import itertools
import math
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from std_srvs.srv import Trigger

from ros_graph import ALL_LATCHED, SECOND, Diagnostics, Inbox, call, ros_arguments, set_parameters
from ros_testing import RunningProcess, StartProcess, spin_until
from set_back_tracker import BACK, SetBackClock
from tpgmm_core import Frame
from tpgmm_msgs.msg import TaskFrame, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.nodes.frame_watch import FrameWatch
from tpgmm_ros.task.task_file import Task

# Each test has a frame of its own, so that one process serves them all
FRAMES = (
    "seen", "lost", "old", "future", "nan", "zero", "foreign", "repeated", "never",
)  # fmt: skip
FADE_TIME = 0.4
GOOD = np.array([0.6, 0.4, 0.1, 0.0, 0.0, math.sin(0.3), math.cos(0.3)])
BAD = GOOD + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def write_task(path: Path, frames: tuple[str, ...] = FRAMES) -> Path:
    topics = "".join(f"  {name}: {{topic: {name}/pose}}\n" for name in frames)
    path.write_text(
        "name: tracking\nbase_frame: base\nmovement: hand/pose\nendpoint: left\n"
        f"frames:\n{topics}  robot: {{pose: [0, 0, 0, 0, 0, 0, 1]}}\n"
        f"tracking: {{visible_timeout: 0.2, hold_time: 0.4, fade_time: {FADE_TIME}, max_age: 1.0, max_future: 0.05}}\n"
    )
    return path


@pytest.fixture(scope="module")
def tracker(start_module_process: StartProcess, tmp_path_factory: pytest.TempPathFactory) -> RunningProcess:
    task = write_task(tmp_path_factory.mktemp("task") / "task.yaml")
    return start_module_process("frame_tracker", *ros_arguments(task_file=task))


@pytest.fixture(scope="module")
def inbox(module_node: Node, tracker: RunningProcess) -> Inbox:
    inbox = Inbox(module_node, TaskParameters, "task_parameters", ALL_LATCHED)
    spin_until(module_node, lambda: inbox.messages, message="task parameters", processes=(tracker,))
    return inbox


@pytest.fixture(scope="module")
def diagnostics(module_node: Node) -> Diagnostics:
    return Diagnostics(module_node)


@pytest.fixture(scope="module")
def show(module_node: Node) -> Callable[..., int]:
    """Publish a pose of a frame, seen `age` seconds ago; returns its stamp, ns."""
    publishers: dict[str, Publisher] = {}

    def publish(
        frame: str, pose: np.ndarray, age: float = 0.0, frame_id: str = "base", stamp: int | None = None
    ) -> int:
        if frame not in publishers:
            publishers[frame] = module_node.create_publisher(PoseStamped, f"{frame}/pose", STREAM)
            spin_until(module_node, lambda: publishers[frame].get_subscription_count() > 0, message=f"{frame}/pose")
        if stamp is None:
            stamp = module_node.get_clock().now().nanoseconds - round(age * SECOND)
        publishers[frame].publish(conversions.pose_stamped(pose, stamp, frame_id))
        return stamp

    return publish


def frame_of(message: TaskParameters | None, name: str) -> TaskFrame:
    assert message is not None
    return next(frame for frame in message.frames if frame.name == name)


def assert_is_pose(frame: TaskFrame, pose: np.ndarray) -> None:
    expected = Frame.from_pose(pose[:3], pose[3:])
    assert (frame.rows, frame.cols) == expected.A.shape
    np.testing.assert_allclose(np.reshape(frame.a, (7, 7)), expected.A, atol=1e-12)
    np.testing.assert_allclose(frame.b, expected.b, atol=1e-12)


def test_poses_become_the_task_parameters_of_their_frames(module_node: Node, inbox: Inbox, show: Callable) -> None:
    scaled = np.concatenate([GOOD[:3], 2.0 * GOOD[3:]])  # quaternions of any length are taken
    stamps: list[int] = []

    def known() -> bool:
        stamps.append(show("seen", scaled))
        frame = frame_of(inbox.last, "seen")
        return frame.status == TaskFrame.VISIBLE and frame.confidence == 1.0

    spin_until(module_node, known, message="full confidence of what is seen")
    frame = frame_of(inbox.last, "seen")
    assert conversions.time_to_ns(frame.stamp) in stamps
    assert_is_pose(frame, GOOD)
    assert inbox.last.header.frame_id == "base"


def test_all_frames_of_the_task_are_named_and_those_never_seen_are_missing(inbox: Inbox) -> None:
    assert [frame.name for frame in inbox.last.frames] == [*FRAMES, "robot"]
    never, robot = frame_of(inbox.last, "never"), frame_of(inbox.last, "robot")
    assert (never.status, never.confidence, len(never.a)) == (TaskFrame.MISSING, 0.0, 0)
    assert (robot.status, robot.confidence) == (TaskFrame.VISIBLE, 1.0)
    assert_is_pose(robot, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))


def test_task_parameters_come_regularly_without_any_pose(module_node: Node, inbox: Inbox) -> None:
    inbox.clear()
    spin_until(module_node, lambda: len(inbox.messages) >= 50, message="50 task parameters")
    stamps = [conversions.time_to_ns(message.header.stamp) for message in inbox.messages]
    assert all(b > a for a, b in itertools.pairwise(stamps))


def test_task_parameters_are_latched_for_nodes_that_start_later(module_node: Node, inbox: Inbox) -> None:
    (publisher,) = module_node.get_publishers_info_by_topic("task_parameters")
    assert publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_a_frame_that_disappears_is_held_then_missing_and_comes_back_without_a_jump(
    module_node: Node, inbox: Inbox, show: Callable
) -> None:
    def seen_fully() -> bool:
        show("lost", GOOD)
        frame = frame_of(inbox.last, "lost")
        return frame.status == TaskFrame.VISIBLE and frame.confidence == 1.0

    spin_until(module_node, seen_fully, message="the frame to be seen")
    inbox.clear()
    spin_until(
        module_node,
        lambda: inbox.messages and frame_of(inbox.last, "lost").status == TaskFrame.MISSING,
        message="MISSING",
    )
    spin_until(module_node, seen_fully, message="the frame to be back")
    frames = [frame_of(message, "lost") for message in inbox.messages]
    order = [status for status, _ in itertools.groupby(frame.status for frame in frames)]
    # what follows depends on how regularly a busy machine lets this test show the frame
    assert order[:4] == [TaskFrame.VISIBLE, TaskFrame.HELD, TaskFrame.MISSING, TaskFrame.VISIBLE]
    held = [frame for frame in frames if frame.status == TaskFrame.HELD]
    assert held[0].confidence == 1.0
    assert any(0.0 < frame.confidence < 1.0 for frame in held)
    for frame in held:
        assert_is_pose(frame, GOOD)
    # Confidence follows the clock: in no interval does it move faster than it may, give or take the scheduling
    confidence = np.array([frame.confidence for frame in frames])
    seconds = 1e-9 * np.array([conversions.time_to_ns(message.header.stamp) for message in inbox.messages])
    assert (np.abs(np.diff(confidence)) <= np.diff(seconds) / FADE_TIME + 0.1).all()


@pytest.mark.parametrize(
    ("frame", "reason", "bad"),
    [
        ("old", "stamp too old", {"age": 2.0}),
        ("future", "stamp in the future", {"age": -1.0}),
        ("nan", "not finite", {"pose": BAD * [1, math.nan, 1, 1, 1, 1, 1]}),
        ("zero", "zero quaternion", {"pose": BAD * [1, 1, 1, 0, 0, 0, 0]}),
        ("foreign", "wrong frame_id", {"frame_id": "camera"}),
    ],
)
def test_a_pose_that_cannot_be_used_is_refused_and_the_last_good_one_stays(
    module_node: Node, inbox: Inbox, show: Callable, diagnostics: Diagnostics, frame: str, reason: str, bad: dict
) -> None:
    def known() -> bool:
        show(frame, GOOD)
        return frame_of(inbox.last, frame).status == TaskFrame.VISIBLE

    spin_until(module_node, known, message="the good pose")
    inbox.clear()

    def refused() -> bool:
        show(frame, **{"pose": BAD, **bad})
        return int(diagnostics.values.get("frame_tracker", {}).get(f"refused_{frame}: {reason}", 0)) > 0

    spin_until(module_node, refused, message=f"the diagnostics to count '{reason}'")
    for message in inbox.messages:
        assert_is_pose(frame_of(message, frame), GOOD)


def test_the_same_observation_again_and_again_does_not_keep_a_frame_visible(
    module_node: Node, inbox: Inbox, show: Callable
) -> None:
    stamp = 0

    def known() -> bool:
        nonlocal stamp
        stamp = show("repeated", GOOD)
        return frame_of(inbox.last, "repeated").status == TaskFrame.VISIBLE

    spin_until(module_node, known, message="the good pose")

    def given_up() -> bool:
        show("repeated", GOOD, stamp=stamp)
        return frame_of(inbox.last, "repeated").status != TaskFrame.VISIBLE

    spin_until(module_node, given_up, message="HELD, since nothing new was seen")


def test_a_flood_of_poses_is_no_flood_of_task_parameters(module_node: Node, inbox: Inbox, show: Callable) -> None:
    inbox.clear()
    count = itertools.count()
    begin = time.monotonic()

    def flooded() -> bool:
        for _ in range(50):
            show("seen", GOOD)
        return next(count) >= 100

    spin_until(module_node, flooded)
    seconds = time.monotonic() - begin
    # At most one per millisecond on change, and the regular hundred per second
    assert 0 < len(inbox.messages) <= 1100.0 * seconds + 20


def test_parameters_that_are_read_at_start_refuse_a_change(module_node: Node, tracker: RunningProcess) -> None:
    result = set_parameters(module_node, "frame_tracker", rate=50.0)
    assert not result.successful and "read" in result.reason


def test_a_change_is_published_at_once_and_not_with_the_next_regular_message(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    task = write_task(tmp_path / "task.yaml", ("seen",))
    process = start_process("frame_tracker", *ros_arguments(task_file=task, rate=1.0))
    inbox = Inbox(ros_node, TaskParameters, "task_parameters", ALL_LATCHED)
    publisher = ros_node.create_publisher(PoseStamped, "seen/pose", STREAM)
    spin_until(ros_node, lambda: publisher.get_subscription_count() > 0, processes=(process,))
    begin = time.monotonic()
    answers = 20
    for _ in range(answers):
        sent: list[int] = []

        def answered(sent: list[int] = sent) -> bool:
            if not sent or ros_node.get_clock().now().nanoseconds - sent[-1] > 0.2 * SECOND:
                sent.append(ros_node.get_clock().now().nanoseconds)
                publisher.publish(conversions.pose_stamped(GOOD, sent[-1], "base"))
            return bool(inbox.messages) and conversions.time_to_ns(frame_of(inbox.last, "seen").stamp) in sent

        spin_until(ros_node, answered, message="the change", processes=(process,))
    # Regular messages alone, one per second, could not have answered so often
    assert time.monotonic() - begin < 0.5 * answers
    process.send_signal(signal.SIGTERM)
    assert process.wait(10.0) == 0


def test_in_lockstep_a_tick_waits_for_perception_and_takes_what_it_saw_earlier(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    task = write_task(tmp_path / "task.yaml", ("left", "right"))
    process = start_process("frame_tracker", *ros_arguments(task_file=task, lockstep=True, use_sim_time=True))
    inbox = Inbox(ros_node, TaskParameters, "task_parameters", ALL_LATCHED)
    topics = {name: f"{name}/pose" for name in ("hand", "left", "right")}
    publishers = {name: ros_node.create_publisher(PoseStamped, topic, STREAM) for name, topic in topics.items()}
    spin_until(
        ros_node,
        lambda: all(publisher.get_subscription_count() for publisher in publishers.values()),
        processes=(process,),
    )

    def answer(tick: int, **seen: tuple[np.ndarray, int]) -> TaskParameters:
        """What is known at a tick, ns, with what was seen and when; sent as often as it takes."""

        def answered() -> bool:
            publishers["hand"].publish(conversions.pose_stamped(GOOD, tick, "base"))
            for name in ("left", "right"):
                pose, stamp = seen.get(name, (np.full(7, np.nan), tick))
                publishers[name].publish(conversions.pose_stamped(pose, stamp, "base"))
            return bool(inbox.messages) and conversions.time_to_ns(inbox.last.header.stamp) == tick

        spin_until(ros_node, answered, message=f"the answer to {tick}", processes=(process,))
        return inbox.last

    tick, late = SECOND, 30_000_000
    assert {frame_of(answer(tick), name).status for name in ("left", "right")} == {TaskFrame.MISSING}
    for i in range(1, 6):
        tick += late
        place = GOOD + 0.01 * i * np.eye(7)[0]
        known = answer(tick, left=(place, tick - late))
        left, right = frame_of(known, "left"), frame_of(known, "right")
        assert left.status == TaskFrame.VISIBLE and right.status == TaskFrame.MISSING
        assert conversions.time_to_ns(left.stamp) == tick - late
        assert left.b[0] == place[0], "what was seen belongs to the tick that it answers"
        known = answer(tick + late // 3)
        assert conversions.time_to_ns(frame_of(known, "left").stamp) == tick - late


@pytest.mark.parametrize("filter_time", [0.0, 1.0])
def test_noisy_poses_are_averaged_over_the_time_that_the_parameter_says(
    filter_time: float, ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    task = write_task(tmp_path / "task.yaml", ("object",))
    process = start_process("frame_tracker", *ros_arguments(task_file=task, filter_time=filter_time))
    inbox = Inbox(ros_node, TaskParameters, "task_parameters", ALL_LATCHED)
    publisher = ros_node.create_publisher(PoseStamped, "object/pose", STREAM)
    random, sent = np.random.default_rng(0), dict[int, np.ndarray]()
    errors: dict[int, np.ndarray] = {}

    def see() -> None:
        pose, stamp = GOOD.copy(), ros_node.get_clock().now().nanoseconds
        pose[:3] += 2e-3 * random.normal(size=3)
        sent[stamp] = pose
        publisher.publish(conversions.pose_stamped(pose, stamp, "base"))

    def has_seen_enough() -> bool:
        for message in inbox.messages:
            frame = frame_of(message, "object")
            stamp = conversions.time_to_ns(frame.stamp)
            if stamp in sent:
                errors[stamp] = np.array(frame.b)[:3] - sent[stamp][:3]
        inbox.messages.clear()
        return len(errors) > 60

    timer = ros_node.create_timer(0.02, see)
    spin_until(ros_node, has_seen_enough, message="frames that are seen", processes=(process,))
    ros_node.destroy_timer(timer)
    last = [errors[stamp] for stamp in sorted(errors)][-20:]
    if filter_time == 0.0:
        np.testing.assert_array_equal(last, 0.0)
    else:
        assert np.std(last) > 1e-3, "what goes out is not the pose that came, which is 2 mm off"


def test_poses_are_taken_again_at_once_after_the_clock_of_the_machine_was_set_back(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    task, script = write_task(tmp_path / "task.yaml", ("seen",)), Path(__file__).with_name("set_back_tracker.py")
    process = start_process(sys.executable, str(script), *ros_arguments(task_file=task))
    inbox = Inbox(ros_node, TaskParameters, "task_parameters", ALL_LATCHED)
    publisher = ros_node.create_publisher(PoseStamped, "seen/pose", STREAM)

    def is_seen(pose: np.ndarray, back_ns: int) -> Callable[[], bool]:
        def check() -> bool:
            stamp_ns = ros_node.get_clock().now().nanoseconds - back_ns
            publisher.publish(conversions.pose_stamped(pose, stamp_ns, "base"))
            frame = frame_of(inbox.last, "seen") if inbox.last is not None else None
            return frame is not None and frame.status == TaskFrame.VISIBLE and np.allclose(frame.b[:3], pose[:3])

        return check

    spin_until(ros_node, is_seen(GOOD, 0), message="the frame", processes=(process,))
    assert call(ros_node, Trigger, "set_back", Trigger.Request()).success
    moved = GOOD + 0.2 * np.eye(7)[0]
    spin_until(ros_node, is_seen(moved, 3600 * SECOND), message="the frame by the new time", processes=(process,))
    assert "time jumped backwards" in process.output


def test_what_a_recorder_shows_of_a_frame_goes_on_after_the_clock_of_the_machine_was_set_back(
    ros_node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SetBackClock(ros_node.get_clock())
    monkeypatch.setattr(ros_node, "get_clock", lambda: clock)
    watch = FrameWatch(ros_node, Task.load(write_task(tmp_path / "task.yaml", ("seen",))))
    publisher = ros_node.create_publisher(PoseStamped, "seen/pose", STREAM)

    def goes_on() -> bool:
        publisher.publish(conversions.pose_stamped(GOOD, clock.now().nanoseconds, "base"))
        (seen,) = watch.frames()
        return not seen.missing and seen.count > before + 10

    before = 0
    spin_until(ros_node, goes_on, message="the frame")
    before, clock.back = watch.frames()[0].count, BACK
    spin_until(ros_node, goes_on, message="the frame by the new time")
