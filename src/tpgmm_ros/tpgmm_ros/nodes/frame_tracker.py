# SPDX-License-Identifier: Apache-2.0
"""frame_tracker: PoseStamped topics in, task parameters out, frames that are not seen tolerated."""

from __future__ import annotations

import functools
import sys

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from tpgmm_core.common.text import shown
from tpgmm_core.observation.tracking import FrameStatus, FrameTracker, TrackedFrame, TrackingConfig
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.lockstep import LateBarrier, is_nothing_seen
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.messages.values import StampedFrames
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.local_topics import publish_value
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters
from tpgmm_ros.runtime.timing import loop_clock
from tpgmm_ros.task.task_file import Task

PARAMETERS = [
    Declared("task_file", "", "Task file (YAML): frames, their topics, time-outs", fixed=True),
    Declared("rate", 100.0, "Task parameters are published this often, Hz", 1.0, 1000.0, fixed=True),
    Declared(
        "filter_time",
        -1.0,
        "Noisy poses are averaged over this time while the frame is at rest, s; 0: never, -1: as in the task file",
        -1.0,
        60.0,
        fixed=True,
    ),
    Declared(
        "lockstep",
        False,
        "Lockstep: answer each pose of the hand once perception has answered it for all frames",
        fixed=True,
    ),
]

#: Changes are published at once, but a flood of poses must not become a flood of task parameters: beyond so many
#: between two regular ones, changes wait for the next of these.
MAX_CHANGES = 10


class FrameTrackerNode(Node):
    """Publishes the frames of a task as the core's `FrameTracker` knows them."""

    def __init__(self) -> None:
        super().__init__("frame_tracker")
        parameters = Parameters(self, PARAMETERS)
        self.task = Task.load(parameters.file("task_file"))
        given = {} if parameters["filter_time"] < 0.0 else {"filter_time": parameters["filter_time"]}
        self.tracker = FrameTracker(
            self.task.topics,
            fixed={name: spec.pose for name, spec in self.task.frames.items() if spec.pose is not None},
            config=TrackingConfig(**(self.task.tracking | given)),
        )
        self._loop_clock = loop_clock(self)
        self._known: list[TrackedFrame] = []
        self._changes = 0
        self._publisher = self.create_publisher(TaskParameters, "task_parameters", LATCHED)
        take = self._observe
        if parameters["lockstep"]:
            take = self._collect
            self._barrier = LateBarrier[PoseStamped](self.task.topics, self._answer, self._send)
            self.create_subscription(PoseStamped, self.task.movement, self._tick, STREAM)
        else:
            self.create_timer(1.0 / parameters["rate"], self._publish_regularly, clock=self._loop_clock)
        for name, topic in self.task.topics.items():
            self.create_subscription(PoseStamped, topic, functools.partial(take, name), STREAM)
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._jump = self.get_clock().create_jump_callback(backwards, post_callback=lambda _: self._forget())
        self.monitor = Monitor(self, self._status)

    # -- in lockstep --------------------------------------------------------------------------------------------------

    def _tick(self, message: PoseStamped) -> None:
        self._barrier.tick(conversions.time_to_ns(message.header.stamp))

    def _collect(self, name: str, message: PoseStamped) -> None:
        seen = None if is_nothing_seen(message) else message
        self._barrier.came(name, conversions.time_to_ns(message.header.stamp), seen)

    def _answer(self, stamp_ns: int, seen: dict[str, PoseStamped | None]) -> None:
        for name in self.task.topics:
            if (message := seen[name]) is not None:
                self._take(name, message, stamp_ns, stamp_ns)
        self._update(stamp_ns)
        self._send(stamp_ns)

    # -- otherwise ----------------------------------------------------------------------------------------------------

    def _observe(self, name: str, message: PoseStamped) -> None:
        steady_ns = self._loop_clock.now().nanoseconds
        if self._take(name, message, self.get_clock().now().nanoseconds, steady_ns) and self._changes < MAX_CHANGES:
            self._changes += 1
            self._publish()

    def _publish_regularly(self) -> None:
        self._changes = 0
        self._publish()

    def _publish(self) -> None:
        self._update(self._loop_clock.now().nanoseconds)
        self._send(self.get_clock().now().nanoseconds)

    # -- always -------------------------------------------------------------------------------------------------------

    def _take(self, name: str, message: PoseStamped, now_ns: int, steady_ns: int) -> bool:
        """Whether the observation was taken."""
        if message.header.frame_id != self.task.base_frame:
            found, expected = message.header.frame_id, self.task.base_frame
            reason = (
                f"wrong frame_id: {shown(found)}, expected {shown(expected)}; transform poses before they are published"
            )
            self._warn(self.tracker.refuse(name, reason))
            return False
        pose, stamp_ns = conversions.pose_to_array(message.pose), conversions.time_to_ns(message.header.stamp)
        refusal = self.tracker.observe(name, pose, stamp_ns, now_ns, steady_ns)
        if refusal:
            self._warn(refusal)
        return refusal is None

    def _update(self, steady_ns: int) -> None:
        self.monitor.asked += 1
        before = {frame.name: frame.status for frame in self._known}
        self._known = self.tracker.update(steady_ns)
        for frame in self._known:
            if before.get(frame.name, frame.status) is not frame.status:
                self.get_logger().info(f"frame '{frame.name}' is {frame.status.name}")
        self.monitor.done += 1

    def _send(self, stamp_ns: int) -> None:
        frames = StampedFrames(tuple(self._known), stamp_ns, self.task.base_frame)
        publish_value(self._publisher, frames, StampedFrames.message)

    def _forget(self) -> None:
        self.get_logger().warning("time jumped backwards: all observations are forgotten")
        self.tracker.forget()

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=2.0)

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        lost = [frame.name for frame in self._known if frame.status is FrameStatus.MISSING]
        values = {f"status_{frame.name}": frame.status.name for frame in self._known}
        for name in self.tracker.names:
            for kind, count in self.tracker.refusals(name).items():
                values[f"refused_{name}: {kind}"] = str(count)
        if lost:
            return DiagnosticStatus.WARN, f"missing: {', '.join(lost)}", values
        return DiagnosticStatus.OK, "all frames are known", values


def main() -> int:
    """Run the node; returns the exit status."""
    return run(FrameTrackerNode)


if __name__ == "__main__":
    sys.exit(main())
