# SPDX-License-Identifier: Apache-2.0
"""reproduction: task parameters and a model in, at every step a Gaussian out: where to be and how much it matters.

A lifecycle node. The action ``reproduce`` starts a movement; its references follow the joint states tick by tick (or
a timer, where no robot publishes them), and go on after the end, so that the robot holds what it has reached.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.poses import check_pose
from tpgmm_core.observation.streams import Beat, Stamp
from tpgmm_core.retrieval.methods import method_named
from tpgmm_core.retrieval.phase import PHASES
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import TaskFrameState
from tpgmm_ros.messages.lockstep import Barrier
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.messages.values import StampedFrames, StampedReference
from tpgmm_ros.models.task_model import known_frames, load_task_models
from tpgmm_ros.nodes.controller_words import ControllerWords
from tpgmm_ros.nodes.joint_states import MAX_FUTURE, SPREAD, Heard, JointStateStream
from tpgmm_ros.nodes.movements import Movements
from tpgmm_ros.nodes.reference_views import ReferenceViews, Seldom, reproduction_status
from tpgmm_ros.nodes.reproduction_parameters import PARAMETERS
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.lifecycle import ManagedNode
from tpgmm_ros.runtime.local_topics import publish_value, receive_values
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Parameters
from tpgmm_ros.runtime.timing import loop_clock
from tpgmm_ros.task.task_file import Task

WATCH_PERIOD = 0.5  # s
FEEDBACK_PERIOD_NS = 100_000_000


class ReproductionNode(ManagedNode):
    """Publishes the references of the movement that `Movements` carries out."""

    def __init__(self) -> None:
        super().__init__("reproduction")
        self.movements: Movements | None = None
        self.parameters = Parameters(self, PARAMETERS, self._check)
        self.monitor = Monitor(self, self._status, self.parameters["joint_state_rate"])
        self._received: object = None
        # A tracker that stopped is noticed by a clock that does not stop.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._received_ns = self._heard_ns = 0
        self._feedback_due = Seldom(FEEDBACK_PERIOD_NS)
        self._beat = Beat()
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        self._sent: StampedReference | None = None
        self._barrier: Barrier[int] | None = None
        if rate := self.parameters["lockstep_rate"]:
            self._barrier = Barrier(("task_parameters", "pose"), self._answer, round(1e9 / rate))
        if self.parameters["autostart"]:
            self.start_itself()

    def _check(self, values: Mapping[str, Any]) -> None:
        if values["retrieval"]:
            method_named(values["retrieval"])
        if values["phase"] not in PHASES:
            raise ValueError(f"there is no phase {shown(values['phase'])}; known are {', '.join(PHASES)}")
        if self.movements is not None:  # last, since it takes effect: only the method knows which speeds it can go
            self.movements.set_speed(values["speed"])

    # -- lifecycle ----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read task and model and subscribe; FAILURE where that cannot be done, with the reason in the log."""
        super().on_configure(state)
        try:
            self.task = Task.load(self.parameters.file("task_file"))
            model_files = self.parameters.files("model_file")
            models = load_task_models(model_files[0], self.task) if model_files else ()
            joints, self._dimensions = self.task.space.joints(), self.task.space.state_dimensions()
        except (ValueError, OSError) as error:
            return self.refuse(error)
        self._references = self.create_lifecycle_publisher(ReferenceMessage, "reference", STREAM)
        self._views = ReferenceViews(self, self.task, self.parameters["broadcast_transforms"])
        task_parameters = self.create_subscription(
            TaskParameters, "task_parameters", self._take_task_parameters, LATCHED
        )
        receive_values(task_parameters, self._take_tracked_frames)
        self.create_subscription(PoseStamped, self.task.movement, self._take_pose, STREAM)
        if self.parameters["rate"] > 0.0:
            self.create_timer(
                1.0 / self.parameters["rate"],
                lambda: self._step(self.get_clock().now().nanoseconds),
                clock=loop_clock(self),
            )
        self._joint_states = JointStateStream(
            self,
            self.task.space.joint_states,
            self._take_joint_state,
            joints or None,
            ("position",),
            self.parameters[SPREAD.name],
            lambda: self.parameters[MAX_FUTURE.name],
        )
        self.movements = Movements(
            self, self.task, models, self.parameters, self._joint_states.why_silent, ControllerWords(self)
        )
        self._received = None
        self.create_timer(WATCH_PERIOD, self.movements.watch, clock=self._steady)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take goals from now on."""
        assert self.movements is not None
        self.movements.activate()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the movement that goes on, and take no more goals."""
        if self.movements is not None:
            self.movements.deactivate()
        self._sent = None  # of the movement that has ended: no answer to a joint state any more
        self._views.hide(self.get_clock().now().nanoseconds)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget model and movement."""
        if self.movements is not None:
            self.movements.close()
        self.movements = None
        return super().on_cleanup(state)

    # -- inputs -------------------------------------------------------------------------------------------------------

    def _take_task_parameters(self, message: TaskParameters) -> None:
        """What a tracker in another process says."""
        received = [
            (item.name, item.status, item.confidence, item.a, item.b, item.pose_covariance) for item in message.frames
        ]
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        self._take_frames(received, lambda: conversions.task_parameters(message), stamp_ns)

    def _take_tracked_frames(self, item: StampedFrames) -> None:
        """What a tracker in this process says."""
        received = [
            (
                *(frame.name, frame.status, frame.confidence, None if frame.pose is None else frame.pose.tolist()),
                *(None if part is None else part.tolist() for part in (frame.covariance, frame.stretch)),
            )
            for frame in item.frames
        ]
        self._take_frames(received, item.states, item.stamp_ns)

    def _take_frames(self, received: object, states: Callable[[], dict[str, TaskFrameState]], stamp_ns: int) -> None:
        self._received_ns = self._steady.now().nanoseconds
        # The same frames again, only observed later, are no change: the reproduction need not adapt to them anew.
        if received != self._received:
            try:
                known = known_frames(states())
            except ValueError as error:
                self.get_logger().error(f"task parameters refused: {error}", throttle_duration_sec=1.0)
            else:
                self._received = received
                if self.movements is not None:
                    self.movements.take_frames(known)
                    self._step_between()
        if self._barrier is not None:
            self._barrier.came("task_parameters", stamp_ns)

    def _take_joint_state(self, heard: Heard) -> None:
        self._heard_ns = self._steady.now().nanoseconds
        for positions in heard.values:  # none where no joint is known
            self._take_state(self.task.space.of_joints(positions))
        if self.parameters["rate"] > 0.0:  # a timer gives the beat
            return
        if self._barrier is not None:
            self._barrier.take(heard.stamp_ns, heard.stamp_ns)
        elif heard.kind is not Stamp.REPEATED:
            if self._beat.take(heard.stamp_ns, self._heard_ns, heard.kind is Stamp.RESTARTED):
                self._step(self._beat.step_ns)
        elif self._sent is not None and self._sent.stamp_ns >= heard.stamp_ns:
            self._send(self._sent)  # it comes again, since an answer was lost

    def _take_pose(self, message: PoseStamped) -> None:
        pose, reason = check_pose(conversions.pose_to_array(message.pose))
        if pose is None:
            self.get_logger().error(f"pose of the robot refused: {reason}", throttle_duration_sec=1.0)
        else:
            self._take_state(self.task.space.of_pose(pose))
        if self._barrier is not None:
            self._barrier.came("pose", conversions.time_to_ns(message.header.stamp))

    def _take_state(self, state: Array | None) -> None:
        if state is not None and self.movements is not None:
            self.movements.state = state

    # -- one step -----------------------------------------------------------------------------------------------------

    def _answer(self, stamp_ns: int) -> None:
        """In lockstep, each state has an answer, and the same one however often it comes."""
        if self._sent is None or self._sent.stamp_ns != stamp_ns:
            self._sent = None
            self._step(stamp_ns)
            if self._sent is None:
                self._send(StampedReference(None, stamp_ns, self.task.base_frame))
        else:
            self._send(self._sent)

    def _send(self, reference: StampedReference) -> None:
        self._sent = reference
        publish_value(self._references, reference, StampedReference.message)

    def _step_between(self) -> None:
        """Frames have changed: their reference need not wait for the next joint state, where that is not near."""
        # Simulated time does not go on between two joint states as far as one can know.
        if self._barrier is None and not self._simulated and self.parameters["rate"] == 0.0:
            if stamp_ns := self._beat.between(self._steady.now().nanoseconds, self.monitor.step.last):
                self._step(stamp_ns, is_tick=False)

    def _step(self, stamp_ns: int, is_tick: bool = True) -> None:
        if self.movements is None or self.movements.sequence is None:
            self._views.hide(stamp_ns)
            return
        start = time.perf_counter()
        if is_tick:
            self.monitor.tick(stamp_ns)
        reference = self.movements.step(stamp_ns)
        if reference is None:
            self._views.hide(stamp_ns)
            return
        named = replace(reference, dimensions=self._dimensions)
        self._send(StampedReference(named, stamp_ns, self.task.base_frame))
        self.monitor.done += is_tick
        self.monitor.step.add(time.perf_counter() - start)
        self._show(stamp_ns, self.movements, reference)

    def _show(self, stamp_ns: int, movements: Movements, reference: Reference) -> None:
        """What is published more rarely, for people and for the action's client."""
        sequence = movements.sequence
        assert sequence is not None
        if self._feedback_due.is_due(stamp_ns):
            movements.goals.tell(reference, (sequence.index + 1, len(sequence.skills), sequence.name))
        self._views.show(stamp_ns, sequence, reference)

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        now_ns = self._steady.now().nanoseconds
        level, message, values = reproduction_status(self.movements, 1e-9 * (now_ns - self._received_ns))
        if self._heard_ns:
            values["joint_state_age_s"] = f"{1e-9 * (now_ns - self._heard_ns):.3f}"
        return level, message, values


def main() -> int:
    """Run the node; returns the exit status."""
    return run(ReproductionNode)


if __name__ == "__main__":
    sys.exit(main())
