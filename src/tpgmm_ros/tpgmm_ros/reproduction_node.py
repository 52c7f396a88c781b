# SPDX-License-Identifier: Apache-2.0
"""reproduction: task parameters and a model in, at every step a Gaussian out: where to be and how much it matters.

A lifecycle node. The action ``reproduce`` starts a movement; its references follow the joint states tick by tick (or
a timer, where no robot publishes them), and go on after the end, so that the robot holds what it has reached.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from tpgmm_core import TPGMM, Frame
from tpgmm_core.execution import Execution, ExecutionConfig, Outcome, Stage
from tpgmm_core.phase import PHASES
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.ways import WAYS, make_retrieval, way_named
from tpgmm_core.tracking import check_pose
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_msgs.msg import TaskParameters
from tpgmm_msgs.srv import LoadModel
from tpgmm_ros import conversions
from tpgmm_ros.background import Background, create_patient_service
from tpgmm_ros.executor import run
from tpgmm_ros.goals import Goals, finish
from tpgmm_ros.lifecycle import ManagedNode
from tpgmm_ros.markers import markers
from tpgmm_ros.monitor import Monitor
from tpgmm_ros.parameters import Declared, Parameters, declared_of
from tpgmm_ros.qos import LATCHED, STREAM
from tpgmm_ros.task import DIMENSIONS, Task
from tpgmm_ros.task_model import known_frames, load_model
from tpgmm_ros.timing import loop_clock

PARAMETERS = [
    Declared("task_file", "", "Task file (YAML): frames and the movement's topic", fixed=True),
    Declared("model_file", "", "Model file (.tpgmm) that is loaded when the node is configured", fixed=True),
    Declared(
        "joint_state_rate", 1000.0, "Joint states that should come, Hz: lost ones are counted", 1.0, 10000.0, fixed=True
    ),
    Declared("autostart", False, "Configure and activate at start, without a lifecycle manager", fixed=True),
    Declared("rate", 0.0, "References on a timer, Hz; 0: one for each joint state", 0.0, 2000.0, fixed=True),
    Declared("retrieval", "", f"Way of retrieval: {', '.join(WAYS)}; empty: what the model was learned for"),
    Declared("phase", "clock", f"What the model's time follows: {', '.join(PHASES)}"),
    Declared("speed", 1.0, "1: as learned; 0: pause; less than 0: back", -2.0, 2.0),
    Declared("horizon_steps", 1, "Gaussians ahead in each reference", 0, 50),
    Declared("horizon_time_step", 0.005, "Time between them, s", 0.001, 1.0),
    Declared("blend_time", 0.15, "Time constant with which moved or lost frames are taken over, s", 0.001, 5.0),
    *declared_of(ExecutionConfig),
]
RETRIEVAL_SETTINGS = ("retrieval", "phase", "speed", "horizon_steps", "horizon_time_step", "blend_time")
WATCH_PERIOD = 0.5  # s
TRACKER_TIMEOUT = 1.0  # s
FEEDBACK_PERIOD_NS = 100_000_000
POSE_PERIOD_NS = 33_000_000
MARKER_PERIOD_NS = 100_000_000

type Prepared = tuple[TPGMM, Retrieval]
"""A model, and a movement of it that is not yet begun."""


class ReproductionNode(ManagedNode):
    def __init__(self) -> None:
        super().__init__("reproduction")
        self.model: TPGMM | None = None
        self.execution: Execution | None = None
        self.parameters = Parameters(self, PARAMETERS, self._check)
        self.monitor = Monitor(self, self._status, self.parameters["joint_state_rate"])
        self._active = False
        self._duration = 0.0
        self._received: list[tuple[Any, ...]] = []
        self._known: dict[str, tuple[Frame, float]] = {}
        self._frames: dict[str, Frame] = {}
        self._weights: dict[str, float] = {}
        self._pose: Any = None
        self._last_ns = 0
        # Ticks that stop, and a tracker that stopped, are noticed by a clock that does not stop.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._stepped_ns = 0
        self._received_ns = 0
        self._done_ns: dict[str, int] = {}
        if self.parameters["autostart"]:
            self.start_itself()

    def _check(self, values: Mapping[str, Any]) -> None:
        if values["retrieval"]:
            way_named(values["retrieval"])
        if values["phase"] not in PHASES:
            raise ValueError(f"there is no phase {values['phase']!r}; known are {', '.join(PHASES)}")
        # Last, since it takes effect: only the way itself knows which speeds it can go.
        if self.execution is not None and self.execution.stage is not Stage.ENDED:
            self.execution.retrieval.speed = values["speed"]

    # -- lifecycle ----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_configure(state)
        try:
            self.task = Task.load(self.parameters.file("task_file"))
            if self.parameters["model_file"]:
                self.model = load_model(self.parameters["model_file"], self.task)
        except (ValueError, OSError) as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._references = self.create_lifecycle_publisher(ReferenceMessage, "reference", STREAM)
        self._reference_poses = self.create_lifecycle_publisher(PoseWithCovarianceStamped, "reference_pose", STREAM)
        self._markers = self.create_lifecycle_publisher(MarkerArray, "markers", STREAM)
        self.create_subscription(TaskParameters, "task_parameters", self._take_task_parameters, LATCHED)
        self.create_subscription(PoseStamped, self.task.movement, self._take_pose, STREAM)
        if self.parameters["rate"] > 0.0:
            self.create_timer(
                1.0 / self.parameters["rate"],
                lambda: self._step(self.get_clock().now().nanoseconds),
                clock=loop_clock(self),
            )
        else:
            self.create_subscription(JointState, "joint_states", self._take_joint_state, STREAM)
        self.create_timer(WATCH_PERIOD, self._watch, clock=self._steady)
        self._background = Background(self)
        create_patient_service(self, LoadModel, "load_model", self._load_model)
        self._goals = Goals(self, self._accept)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = True
        self._last_ns = 0  # what the clock said before is no time to jump back from
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False
        self._end("the node was deactivated")
        self.execution = None
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._background.close()
        self._goals.destroy()
        return super().on_cleanup(state)

    # -- inputs -------------------------------------------------------------------------------------------------------

    def _take_task_parameters(self, message: TaskParameters) -> None:
        self._received_ns = self._steady.now().nanoseconds
        # The same frames again, only observed later, are no change: the reproduction need not adapt to them anew.
        received = [(item.name, item.status, item.confidence, item.a, item.b) for item in message.frames]
        if received == self._received:
            return
        try:
            known = known_frames(conversions.task_parameters(message))
        except ValueError as error:
            self.get_logger().error(f"task parameters refused: {error}", throttle_duration_sec=1.0)
            return
        self._received = received
        self._known = known
        self._choose_frames()

    def _choose_frames(self) -> None:
        """Of the frames that are known, those that the model has learned from."""
        if self.execution is not None:
            self._frames, self._weights = those_of(self.execution.retrieval, self._known)

    def _take_joint_state(self, message: JointState) -> None:
        self._step(conversions.time_to_ns(message.header.stamp))

    def _take_pose(self, message: PoseStamped) -> None:
        pose, reason = check_pose(conversions.pose_to_array(message.pose))
        if pose is None:
            self.get_logger().error(f"pose of the robot refused: {reason}", throttle_duration_sec=1.0)
        else:
            self._pose = pose

    # -- models and goals, prepared in the background -----------------------------------------------------------------

    def _prepare(self, path: str, then: Callable[[Future[Prepared]], None], duration: float) -> None:
        """Read the model in a file (the one in use where there is none) and make it ready, while steps go on."""
        task, model, known, pose = self.task, self.model, self._known, self._pose
        settings = {name: self.parameters[name] for name in RETRIEVAL_SETTINGS}
        way = settings.pop("retrieval") or None

        def work() -> Prepared:
            chosen = load_model(path, task) if path else model
            if chosen is None:
                raise ValueError("no model is loaded: name a model file in the goal, or set the parameter model_file")
            retrieval = make_retrieval(chosen, way, duration=duration or None, **settings)
            frames, weights = those_of(retrieval, known)
            if frames:  # a rehearsal: what cannot be adapted to the situation is refused before anything depends on it
                retrieval.start(0, pose)
                retrieval.step(0, frames, pose, weights)
            return chosen, retrieval

        self._background.run(work, then)

    def _load_model(self, request: LoadModel.Request) -> Future[LoadModel.Response]:
        answer: Future[LoadModel.Response] = Future()
        self._prepare(request.path, partial(self._take_model, request.path, answer), self._duration)
        return answer

    def _take_model(self, path: str, answer: Future[LoadModel.Response], job: Future[Prepared]) -> None:
        """Use a model from now on, also for the movement that is going on."""
        try:
            model, retrieval = job.result()
            self._go_on_with(retrieval)
        except (ValueError, OSError) as error:
            answer.set_result(LoadModel.Response(success=False, reason=str(error)))
            return
        self.model = model
        self.get_logger().info(f"loaded {path}")
        answer.set_result(LoadModel.Response(success=True))

    def _go_on_with(self, retrieval: Retrieval) -> None:
        """Let another model, or another way, carry out the movement that is going on, if one is."""
        if self.execution is None or self.execution.stage is Stage.ENDED:
            return
        unseen = [name for name in retrieval.frame_names if name not in self._known]
        if unseen:
            raise ValueError(f"the frames {', '.join(unseen)} are not seen, and a movement is being reproduced")
        self.execution.take_over(retrieval, self._pose)
        self._choose_frames()

    def _accept(self, goal: ServerGoalHandle) -> None:
        self._prepare(goal.request.model, partial(self._begin, goal), goal.request.duration)

    def _begin(self, goal: ServerGoalHandle, job: Future[Prepared]) -> None:
        try:
            if not self._active:
                raise ValueError("the node is not active: activate it first")
            _, retrieval = job.result()
            execution = Execution(retrieval, self.parameters.fill(ExecutionConfig))
        except (ValueError, OSError) as error:
            finish(goal, Outcome(False, str(error)))
            return
        if goal.is_cancel_requested:
            finish(goal, Outcome(False, "canceled"))
            return
        self._end("another movement was asked for")
        self._goals.begin(goal)
        self.execution, self._duration = execution, goal.request.duration
        self._stepped_ns = self._steady.now().nanoseconds
        self._choose_frames()

    def _end(self, reason: str) -> None:
        """Stop the movement that is going on, if one is."""
        if self.execution is not None:
            self.execution.stop(self._last_ns, reason)
            self._report_end()

    def _report_end(self) -> None:
        if self.execution is not None and self.execution.outcome is not None:
            self._goals.end(self.execution.outcome)

    def _watch(self) -> None:
        """Ticks that do not come cannot notice it themselves."""
        silence = 1e-9 * (self._steady.now().nanoseconds - self._stepped_ns)
        if self._goals.is_cancel_requested:
            self._end("canceled")
        if self._goals.is_going_on and silence > self.parameters["start_timeout"]:
            self._end(f"no joint states for {silence:.1f} s: is the robot running, and is the topic the right one?")

    # -- one step -----------------------------------------------------------------------------------------------------

    def _step(self, stamp_ns: int) -> None:
        execution = self.execution
        if execution is None or not self._active:
            return
        start = time.perf_counter()
        self._stepped_ns = self._steady.now().nanoseconds
        if stamp_ns < self._last_ns:
            self.get_logger().warning("time jumped backwards")
            self._end("time jumped backwards")
        self._last_ns = stamp_ns
        self.monitor.tick(stamp_ns)
        if self._goals.is_cancel_requested:
            self._end("canceled")
        try:
            reference = execution.step(stamp_ns, self._frames, self._pose, self._weights)
        except ValueError as error:  # a situation that the model cannot be adapted to; the controller holds, then damps
            self._end(f"no reference can be given: {error}")
            self.get_logger().error(f"no reference can be given: {error}")
            self.execution = None
            return
        self._report_end()
        if reference is None:
            return
        self._references.publish(
            conversions.reference_message(reference, DIMENSIONS[1:], stamp_ns, self.task.base_frame)
        )
        self.monitor.done += 1
        self.monitor.step.add(time.perf_counter() - start)
        self._show(stamp_ns, execution)

    def _show(self, stamp_ns: int, execution: Execution) -> None:
        """What is published more rarely, for people and for the action's client."""
        reference = execution.reference
        assert reference is not None
        frame_id = self.task.base_frame
        if self._is_due("feedback", stamp_ns, FEEDBACK_PERIOD_NS):
            self._goals.tell(reference.phase, reference.frames)
        if self._is_due("pose", stamp_ns, POSE_PERIOD_NS):
            self._reference_poses.publish(conversions.pose_with_covariance(reference.gaussian, stamp_ns, frame_id))
        if self._markers.get_subscription_count() and self._is_due("markers", stamp_ns, MARKER_PERIOD_NS):
            mixture = execution.retrieval.mixture()
            self._markers.publish(markers(mixture, reference.activations, self._frames, stamp_ns, frame_id))

    def _is_due(self, what: str, stamp_ns: int, period_ns: int) -> bool:
        if 0 <= stamp_ns - self._done_ns.get(what, -period_ns) < period_ns:
            return False
        self._done_ns[what] = stamp_ns
        return True

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        if self.execution is None:
            return DiagnosticStatus.OK, "waiting for a request", {}
        reference = self.execution.reference
        values = {"stage": self.execution.stage.value, "frames": ", ".join(self._frames)}
        if reference is not None:
            values["phase"] = f"{reference.phase:.3f}"
        silence = 1e-9 * (self._steady.now().nanoseconds - self._received_ns)
        if silence > TRACKER_TIMEOUT:
            return DiagnosticStatus.ERROR, f"no task parameters for {silence:.1f} s: is frame_tracker alive?", values
        missing = [name for name in self.execution.retrieval.frame_names if name not in self._frames]
        if missing:
            return DiagnosticStatus.WARN, f"reproducing without {', '.join(missing)}", values
        return DiagnosticStatus.OK, "reproducing", values


def those_of(
    retrieval: Retrieval, known: Mapping[str, tuple[Frame, float]]
) -> tuple[dict[str, Frame], dict[str, float]]:
    """Of the frames that are known, those that a model has learned from, and how far each is trusted."""
    names = [name for name in retrieval.frame_names if name in known]
    return {name: known[name][0] for name in names}, {name: known[name][1] for name in names}


def main() -> int:
    return run(ReproductionNode)


if __name__ == "__main__":
    sys.exit(main())
