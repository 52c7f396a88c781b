# SPDX-License-Identifier: Apache-2.0
"""Poses that are wrong, missing, too many, or of two minds, during a movement of the whole graph."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped

from faults.graph_bench import GraphBench
from faults.table import fault
from ros_graph import SECOND
from tpgmm_msgs.msg import TaskFrame
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM

#: The velocity of the reference may change by this in one step, or by twice what it does without a fault, m/s.
JUMP = 0.05


def with_nan(message: PoseStamped) -> None:
    message.pose.position.y = math.nan


def infinite(message: PoseStamped) -> None:
    message.pose.position.z = math.inf


def without_orientation(message: PoseStamped) -> None:
    orientation = message.pose.orientation
    orientation.x = orientation.y = orientation.z = orientation.w = 0.0


def of_the_camera(message: PoseStamped) -> None:
    message.header.frame_id = "camera"


def in_an_hour(message: PoseStamped) -> None:
    message.header.stamp.sec += 3600


def ten_seconds_ago(message: PoseStamped) -> None:
    message.header.stamp.sec -= 10


class Frozen:
    """The stamp of the first message, again and again."""

    def __init__(self) -> None:
        self._stamp: object = None

    def __call__(self, message: PoseStamped) -> None:
        self._stamp = self._stamp or message.header.stamp
        message.header.stamp = self._stamp


BAD_POSES: dict[str, tuple[Callable[[], Callable[[PoseStamped], None]], str]] = {
    "with NaN": (lambda: with_nan, "not finite"),
    "with infinite positions": (lambda: infinite, "not finite"),
    "with a quaternion of length 0": (lambda: without_orientation, "zero quaternion"),
    "in a wrong frame_id": (lambda: of_the_camera, "wrong frame_id"),
    "an hour ahead of the clock": (lambda: in_an_hour, "stamp in the future"),
    "10 s old": (lambda: ten_seconds_ago, "stamp too old"),
    "with stamps that do not change": (Frozen, "repeated stamp"),
}


def refused(bench: GraphBench, kind: str) -> int:
    """How many poses of the object frame_tracker has refused for this reason."""
    return int(bench.diagnostics.values.get("frame_tracker", {}).get(f"refused_object: {kind}", 0))


def assert_smooth(bench: GraphBench) -> str:
    """The reference's velocity never jumped."""
    speed, change = bench.reference_steps()
    _, usual = bench.usual
    assert change < max(JUMP, 2.0 * usual), (
        f"the reference's velocity changed by {change} m/s in one step ({usual} usual)"
    )
    return f"reference at most {speed:.2f} m/s, its largest change in one step {change:.3f} m/s ({usual:.3f} otherwise)"


def enter_bad_poses(name: str, make: Callable[[], Callable[[PoseStamped], None]], kind: str) -> None:
    @fault(
        GraphBench,
        f"poses {name}, during a movement",
        "refused and counted in the diagnostics; the frame is HELD where it was, and the movement ends well",
        quick=False,
    )
    def bad_poses(bench: GraphBench) -> str:
        before = refused(bench, kind)
        goal = bench.move(until=0.1)
        spoil, place = make(), bench.situation.object
        bench.distort = lambda frame, message: spoil(message) if frame == "object" else None
        bench.spin_for(0.1)
        bench.places["object"] = place + [0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0]  # would be seen if it were taken
        bench.frames.clear()
        bench.wait(lambda: refused(bench, kind) - before > 20, f"the diagnostics to count '{kind}'")
        result = bench.result(goal)
        statuses = [item.status for item in bench.seen("object")]
        far = max(float(np.linalg.norm(np.array(item.b[:3]) - place[:3])) for item in bench.seen("object"))
        assert result.success, result.reason
        assert far < 1e-6, f"a pose {far} m away was taken"
        assert TaskFrame.HELD in statuses
        bench.assert_sound()
        return f"{refused(bench, kind) - before} counted as '{kind}', HELD; {result.reason}; {assert_smooth(bench)}"


for _name, (_make, _kind) in BAD_POSES.items():
    enter_bad_poses(_name, _make, _kind)


@fault(
    GraphBench,
    "an object is not seen for 1 s",
    "HELD with its last pose, VISIBLE again at once; nobody notices it in the reference",
    quick=False,
)
def not_seen(bench: GraphBench) -> str:
    goal = bench.move(until=0.3)
    hidden = bench.places.pop("object")
    bench.spin_for(1.0)
    bench.places["object"] = hidden
    result = bench.result(goal)
    assert result.success, result.reason
    order = [status for status, _ in itertools.groupby(item.status for item in bench.seen("object"))]
    assert set(order) == {TaskFrame.VISIBLE, TaskFrame.HELD} and order[-1] == TaskFrame.VISIBLE, order
    return f"HELD, then VISIBLE; {result.reason}; {assert_smooth(bench)}; {bench.assert_sound()}"


@fault(
    GraphBench,
    "the target of a movement is lost for a while, long before it is needed",
    "MISSING after visible_timeout, hold_time and fade_time; the movement goes on without it, as the diagnostics say",
    quick=False,
)
def lost(bench: GraphBench) -> str:
    goal = bench.move(duration=20.0, until=0.03)
    hidden = bench.places.pop("target")
    seconds = bench.wait(lambda: bench.seen("target")[-1].status == TaskFrame.MISSING, "MISSING")
    bench.wait(bench.said("reproduction", "reproducing without target"), "the diagnostics to tell")
    bench.places["target"] = hidden
    result = bench.result(goal)
    assert result.success, result.reason
    bench.assert_sound()
    return f"MISSING after {seconds:.1f} s, 'reproducing without target', {result.reason}, {assert_smooth(bench)}"


@fault(
    GraphBench,
    "an object that the hand may carry is lost for good",
    "HELD where it was, since it was not seen to move with the hand, as the diagnostics say; the movement goes on",
    quick=False,
)
def covered(bench: GraphBench) -> str:
    goal = bench.move(duration=10.0, until=0.6)
    del bench.places["object"]
    bench.wait(
        lambda: "was not seen to move with the hand" in str(bench.diagnostics.values.get("frame_tracker", {})),
        "the note",
    )
    result = bench.result(goal)
    assert result.success, result.reason
    assert bench.seen("object")[-1].status == TaskFrame.HELD
    bench.assert_sound()
    return f"HELD, 'was not seen to move with the hand', {result.reason}, {assert_smooth(bench)}"


@fault(
    GraphBench,
    "the target of a movement is lost before its end, and is seen again later",
    "the movement waits, in words in the diagnostics, and goes on from there without a jump to its end",
    quick=False,
)
def needed(bench: GraphBench) -> str:
    goal = bench.move(duration=10.0, until=0.5)
    hidden = bench.places.pop("target")
    bench.wait(bench.said("reproduction", "waits: without target"), "the diagnostics to tell")
    bench.spin_for(1.0)  # until it has come to rest
    waited, phase = bench.references.messages[-1], bench.phase()
    bench.spin_for(2.0)
    assert bench.phase() - phase < 1e-3 and phase < 0.99, f"the movement went on from {phase} to {bench.phase()}"
    moved = np.linalg.norm(np.array(bench.references.messages[-1].gaussian.mean[:3]) - waited.gaussian.mean[:3])
    assert moved < 1e-3, f"the reference went on by {1e3 * moved} mm"
    bench.places["target"] = hidden
    result = bench.result(goal)
    assert result.success, result.reason
    observed = f"waited at {100 * phase:.0f} % of the way, {1e3 * moved:.2f} mm in 2 s"
    return f"{observed}; {result.reason}; {assert_smooth(bench)}; {bench.assert_sound()}"


@fault(
    GraphBench,
    "an object leaps by 8 cm during a movement",
    "the reference goes over to the new course with continuous velocity",
    quick=False,
)
def leaps(bench: GraphBench) -> str:
    goal = bench.move(until=0.2)
    bench.places["object"] = bench.situation.object + [0.0, 0.08, 0.0, 0.0, 0.0, 0.0, 0.0]
    result = bench.result(goal)
    assert result.success, result.reason
    return f"{result.reason}; {assert_smooth(bench)}; {bench.assert_sound()}"


@fault(
    GraphBench,
    "a flood of poses, 10 000 per second, during a movement",
    "no flood of task parameters (at most 1100 per second); the movement ends well, torques within limits and rates",
    quick=False,
)
def flood(bench: GraphBench) -> str:
    place = " ".join(str(number) for number in bench.situation.object)
    script = Path(__file__).with_name("flood.py")
    source = bench.start_program(sys.executable, str(script), "object/pose", "10000", *place.split())
    bench.wait(lambda: "flooding" in source.output, "the flood")
    goal = bench.move(until=0.05)
    bench.frames.clear()
    began = bench.now_ns()
    result = bench.result(goal)
    seconds = 1e-9 * (bench.now_ns() - began)
    count = len(bench.frames.messages)
    source.stop()
    rate = float(source.output.split()[-1])
    assert result.success, result.reason
    assert count <= 1100 * seconds + 20, f"{count / seconds} task parameters per second"
    bench.assert_sound()
    return f"{rate:.0f} poses per second, {count / seconds:.0f} task parameters per second, {result.reason}"


@fault(
    GraphBench,
    "two cameras that disagree by 5 cm on one topic, during a movement",
    "frame_tracker names both in its diagnostics; the reference stays smooth, torques within limits and rates",
    quick=False,
)
def two_cameras(bench: GraphBench) -> str:
    second = bench.node.create_publisher(PoseStamped, "object/pose", STREAM)
    other = bench.situation.object + [0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]

    def see_otherwise() -> None:
        second.publish(conversions.pose_stamped(other, bench.now_ns() + SECOND // 1000, "base"))

    timer = bench.node.create_timer(0.021, see_otherwise)
    words = "2 publishers on /object/pose"
    bench.wait(bench.said("frame_tracker", words), "the diagnostics to tell")
    goal = bench.move()
    result = bench.result(goal)
    bench.node.destroy_timer(timer)
    bench.node.destroy_publisher(second)
    assert "from the model's end of the movement" in result.reason, result.reason
    return f"'{words}'; {result.reason}; {bench.assert_sound()}"
