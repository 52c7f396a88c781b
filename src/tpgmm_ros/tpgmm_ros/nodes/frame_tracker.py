# SPDX-License-Identifier: Apache-2.0
"""frame_tracker: poses of frames in, task parameters out, frames that are not seen tolerated."""

from __future__ import annotations

import functools
import math
import sys

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.observation.health import FrameHealth
from tpgmm_core.observation.poses import Observation, wrong_frame
from tpgmm_core.observation.streams import ClockWatch
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame, TrackingConfig
from tpgmm_core.observation.tracking import FrameTracker
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.broadcasting import TransformBroadcaster
from tpgmm_ros.messages.lockstep import LateBarrier, is_nothing_seen
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.messages.sources import PoseStampedSource, Source
from tpgmm_ros.messages.values import StampedFrames
from tpgmm_ros.nodes.frame_sources import FrameSources
from tpgmm_ros.nodes.gripper_signals import subscribe_to_grippers
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.local_topics import publish_value
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters
from tpgmm_ros.runtime.timing import loop_clock
from tpgmm_ros.task.task_file import Task

PARAMETERS = [
    Declared("task_file", "", "Task file (YAML): frames, their topics, time-outs", fixed=True),
    Declared("broadcast_transforms", False, "Publish the frames on /tf too, as TASK/FRAME, for viewers", fixed=True),
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
        "use_covariances",
        True,
        "Use covariances that come with poses, so that uncertain poses count less; false: all poses count as exact",
        fixed=True,
    ),
    Declared(
        "lockstep",
        False,
        "Lockstep: answer each pose of the hand once perception has answered it for all frames",
        fixed=True,
    ),
]

#: The hand among the sources; no frame's name has a space.
_HAND = "the hand"
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
            self.task.sources,
            fixed={name: spec.pose for name, spec in self.task.frames.items() if spec.pose is not None},
            config=TrackingConfig(**(self.task.tracking | given)),
            unknown_after=self.task.unknown_after,
            with_hand=self.task.with_hand,
        )
        self._uses_covariances = parameters["use_covariances"]
        self._loop_clock = loop_clock(self)
        self._known: list[TrackedFrame] = []
        self._changes = 0
        self._clock_watch = ClockWatch()
        self._publisher = self.create_publisher(TaskParameters, "task_parameters", LATCHED)
        self._transforms = TransformBroadcaster(self) if parameters["broadcast_transforms"] else None
        self._sources: FrameSources | None = None
        if parameters["lockstep"]:
            self._subscribe_in_lockstep()
        else:
            sources: dict[str, Source] = dict(self.task.sources)
            if self.task.with_hand:
                sources[_HAND] = PoseStampedSource(self.task.movement)
            self._sources = FrameSources(self, sources, self.task.base_frame, self._observe, self._refuse, self._fix)
            self.create_timer(1.0 / parameters["rate"], self._publish_regularly, clock=self._loop_clock)
        self._grippers = subscribe_to_grippers(self, self.task.grippers, self._grip, self._warn)
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._jump = self.get_clock().create_jump_callback(backwards, post_callback=lambda _: self._forget())
        self.monitor = Monitor(self, self._status)

    # -- in lockstep --------------------------------------------------------------------------------------------------

    def _subscribe_in_lockstep(self) -> None:
        if others := self.task.sources.keys() - self.task.topics.keys():
            raise ValueError(
                "in lockstep, each frame must be observed as PoseStamped, which can report that nothing was seen; the "
                f"task file has other sources for {listed(sorted(others))}"
            )
        self._barrier = LateBarrier[PoseStamped](self.task.topics, self._answer, self._send)
        self.create_subscription(PoseStamped, self.task.movement, self._tick, STREAM)
        for name, topic in self.task.topics.items():
            self.create_subscription(PoseStamped, topic, functools.partial(self._collect, name), STREAM)

    def _tick(self, message: PoseStamped) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if self.task.with_hand:
            self._take_in_base(_HAND, message, stamp_ns)
        self._barrier.tick(stamp_ns)

    def _collect(self, name: str, message: PoseStamped) -> None:
        seen = None if is_nothing_seen(message) else message
        self._barrier.came(name, conversions.time_to_ns(message.header.stamp), seen)

    def _answer(self, stamp_ns: int, seen: dict[str, PoseStamped | None]) -> None:
        for name in self.task.topics:
            if (message := seen[name]) is not None:
                self._take_in_base(name, message, stamp_ns)
        self._update(stamp_ns)
        self._send(stamp_ns)

    def _take_in_base(self, name: str, message: PoseStamped, stamp_ns: int) -> None:
        observation = PoseStampedSource.observation(message)
        if reason := wrong_frame(observation.frame_id, self.task.base_frame):
            self._refuse(name, reason)
        else:
            self._take(name, observation, stamp_ns, stamp_ns)

    # -- otherwise ----------------------------------------------------------------------------------------------------

    def _observe(self, name: str, observation: Observation) -> None:
        steady_ns, now_ns = self._loop_clock.now().nanoseconds, self.get_clock().now().nanoseconds
        if self._take(name, observation, now_ns, steady_ns) and self._changes < MAX_CHANGES:
            self._changes += 1
            self._publish()

    def _publish_regularly(self) -> None:
        self._changes = 0
        # no callback tells it of the system's clock
        if self._clock_watch.was_set_back(self.get_clock().now().nanoseconds):
            self._forget()
        self._publish()

    def _publish(self) -> None:
        self._update(self._loop_clock.now().nanoseconds)
        self._send(self.get_clock().now().nanoseconds)

    # -- always -------------------------------------------------------------------------------------------------------

    def _take(self, name: str, observation: Observation, now_ns: int, steady_ns: int) -> bool:
        """Whether a frame's observation was taken."""
        stamp_ns, pose = observation.stamp_ns, observation.pose
        if name == _HAND:
            if reason := self.tracker.observe_hand(pose, stamp_ns, steady_ns):
                self._refuse(name, reason)
            return False
        covariance = observation.covariance if self._uses_covariances else None
        stretch, lasts = observation.stretch, observation.lasts
        refusal = self.tracker.observe(name, pose, stamp_ns, now_ns, steady_ns, covariance, stretch, lasts)
        if refusal:
            self._warn(refusal)
        return refusal is None

    def _refuse(self, name: str, reason: str) -> None:
        self._warn(f"{name}: {reason}" if name == _HAND else self.tracker.refuse(name, reason))

    def _grip(self, name: str, closed: bool, stamp_ns: int) -> None:
        self.tracker.observe_gripper(name, closed, stamp_ns, self._loop_clock.now().nanoseconds)

    def _fix(self, name: str, pose: Array) -> None:
        if refusal := self.tracker.fix(name, pose):
            self._warn(refusal)

    def _update(self, steady_ns: int) -> None:
        self.monitor.asked += 1
        before = {frame.name: frame.status for frame in self._known}
        self._known = self.tracker.update(steady_ns, () if self._sources is None else self._sources.kept)
        for frame in self._known:
            if before.get(frame.name, frame.status) is not frame.status:
                self.get_logger().info(f"frame '{frame.name}' is {frame.status.name}")
        self.monitor.done += 1

    def _send(self, stamp_ns: int) -> None:
        frames = StampedFrames(tuple(self._known), stamp_ns, self.task.base_frame)
        publish_value(self._publisher, frames, StampedFrames.message)
        if self._transforms is not None:
            known = [frame for frame in self._known if frame.status is not FrameStatus.MISSING]
            base, task = self.task.base_frame, self.task.name
            poses = {(base, f"{task}/{frame.name}"): frame.pose for frame in known if frame.pose is not None}
            self._transforms.send(stamp_ns, poses)

    def _forget(self) -> None:
        self.get_logger().warning("time jumped backwards: all observations are forgotten")
        self._clock_watch = ClockWatch()
        self.tracker.forget()
        if self._sources is not None:
            self._sources.forget()
        for gripper in self._grippers:
            gripper.hear_again()

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=2.0)

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        for gripper in self._grippers:
            gripper.fit()
        lost = [frame.name for frame in self._known if frame.status is FrameStatus.MISSING]
        values = {f"status_{frame.name}": frame.status.name for frame in self._known}
        said = [f"missing: {', '.join(lost)}"] if lost else []
        frames = self.tracker.health(self._loop_clock.now().nanoseconds)
        reasons = {name: health.trouble for name, health in frames.items() if health.trouble}
        if self._sources is not None:
            reasons = self._sources.unpublished() | reasons | self._sources.unknown()
        said += [f"frame '{name}': {reason}" for name, reason in reasons.items() if name in lost]
        for name, health in frames.items():
            values |= _values(name, health)
            said += [f"frame '{name}': {doubt}" for doubt in health.doubts]
        if said:
            return DiagnosticStatus.WARN, "; ".join(said), values
        return DiagnosticStatus.OK, "all frames are known", values


def _values(name: str, health: FrameHealth) -> dict[str, str]:
    """One frame in the diagnostics."""
    values = {} if health.age is None else {f"age_{name}_s": f"{health.age:.3f}"}
    if health.rate is not None:
        values[f"rate_{name}_hz"] = f"{health.rate:.1f}"
    values[f"noise_{name}"] = f"{1e3 * health.noise[0]:.2f} mm, {math.degrees(health.noise[1]):.2f} deg"
    values |= {f"refused_{name}: {kind}": str(count) for kind, count in health.refused.items()}
    return values | {f"note_{name}_{i}": note for i, note in enumerate(health.notes, 1)}


def main() -> int:
    """Run the node; returns the exit status."""
    return run(FrameTrackerNode)


if __name__ == "__main__":
    sys.exit(main())
