# SPDX-License-Identifier: Apache-2.0
"""What the nodes say, at most thirty times per second: topics -> `GraphView`."""

from __future__ import annotations

import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.observation.external_torques import MeasuredForce
from tpgmm_core.observation.joint_states import MAX_SPREAD
from tpgmm_core.observation.poses import check_pose
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.msg import ControllerState, TaskFrame, TaskParameters
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointStates, MessageError
from tpgmm_ros.messages.joint_state_bytes import JointStateDecoder
from tpgmm_ros.messages.qos import EVENTS, LATCHED, STATES, STREAM
from tpgmm_ros.nodes.hand_force import LASTS, WRENCH, HandForce
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.graph.latest import Looker
from tpgmm_workbench.session.refusals import Refusals
from tpgmm_workbench.session.view import (
    ComponentView,
    ControllerView,
    FrameView,
    GraphView,
    HorizonView,
    NodeView,
    ReferenceView,
    StiffnessView,
    TorqueView,
)

#: What was said longer ago is not shown any more, s: streams, and what comes once per second or when it changes.
STREAM_LASTS, WORDS_LAST = 0.5, 3.5
_STATES = {TaskFrame.VISIBLE: "seen", TaskFrame.HELD: "held", TaskFrame.MISSING: "missing"}


class Watcher:
    """Looks at what the nodes say of a task and a robot.

    Parameters
    ----------
    node
        whose topics are looked at
    task
        names the movement and the frames
    robot
        whose joints they are
    feels
        whether it is asked how hard somebody pushes the hand
    """

    def __init__(self, node: Node, task: Task, robot: RobotModel, feels: bool = False) -> None:
        self._node, self._task = node, task
        self._looker = Looker(node)
        topic = self._looker.topic
        self._joints = topic(JointState, "joint_states", STATES, raw=True)
        self._decode = JointStateDecoder()
        self._states = JointStates(robot.joint_names, ("position",), MAX_SPREAD)
        self._hand = topic(PoseStamped, task.movement, STREAM)
        self._frames = topic(TaskParameters, "task_parameters", LATCHED)
        self._controller = topic(ControllerState, "controller_state", LATCHED)
        self._reference = topic(PoseWithCovarianceStamped, "reference_pose", STREAM)
        self._ahead = topic(ReferenceMessage, "reference_ahead", STREAM)
        self._horizon: HorizonView | None = None
        self._markers = topic(MarkerArray, "markers", STREAM)
        self._diagnostics = topic(DiagnosticArray, "/diagnostics", EVENTS)
        self._force = HandForce(robot, task.endpoint) if feels else None
        self._wrenches = topic(WrenchStamped, WRENCH, STREAM) if feels else None
        self._refusals = Refusals()
        self._limits = {
            name: (float(limit), "N" if unit == "m" else "N m")
            for name, unit, limit in zip(robot.joint_names, robot.joint_units, robot.effort_limits, strict=True)
        }
        self._q: Array | None = None
        self._components: dict[int, ComponentView] = {}
        self._nodes: dict[str, tuple[float, NodeView]] = {}

    def close(self) -> None:
        """Look no more."""
        self._looker.close()

    def look(self) -> GraphView:
        """What is known now."""
        self._take_joints()
        self._take_diagnostics()
        controller = self._newest_of_controller()
        is_heard = self._joints.silence < WORDS_LAST
        return GraphView(
            joints=self._q if is_heard else None,
            hand=self._pose_of_hand(),
            frames=self._known_frames(),
            controller=None if controller is None else _words_in(controller),
            reference=self._known_reference(),
            horizon=self._known_horizon(),
            components=self._known_components(),
            torques=() if controller is None else self._torques_in(controller),
            stiffness=None if controller is None else _stiffness_in(controller),
            force=self._known_force(is_heard),
            nodes={name: view for name, (came, view) in self._nodes.items() if time.monotonic() - came < WORDS_LAST},
        )

    def _take_joints(self) -> None:
        for data in self._joints.take():
            try:
                message = self._decode(data)
                sample = self._states.take(message)
            except (MessageError, RuntimeError):  # the nodes that follow them say what is wrong with them
                continue
            if sample is not None:
                (self._q,) = sample.values
            if self._force is not None:
                self._force.take(message, self._q)

    def _known_force(self, is_heard: bool) -> MeasuredForce | None:
        if self._force is None or self._wrenches is None:
            return None
        wrench = self._wrenches.newest()
        return self._force.measured(wrench if self._wrenches.silence <= LASTS else None, is_heard)

    def _pose_of_hand(self) -> Array | None:
        message = self._hand.newest()
        if message is None or self._hand.silence > WORDS_LAST:
            return None
        pose, _ = check_pose(conversions.pose_to_array(message.pose))
        return pose

    def _known_frames(self) -> tuple[FrameView, ...]:
        message, now = self._frames.newest(), time.monotonic()
        told = {} if message is None or self._frames.silence > WORDS_LAST else {i.name: i for i in message.frames}
        clock_ns = self._node.get_clock().now().nanoseconds
        views = []
        for name, spec in self._task.frames.items():
            if spec.pose is not None:
                views.append(FrameView(name, "fixed", pose=np.array(spec.pose)))
            elif name in told:
                views.append(self._frame(told[name], clock_ns, now))
            else:
                views.append(FrameView(name, "missing"))
        return tuple(views)

    def _frame(self, item: TaskFrame, clock_ns: int, now: float) -> FrameView:
        stamp_ns = conversions.time_to_ns(item.stamp)
        age = max(0.0, 1e-9 * (clock_ns - stamp_ns)) if stamp_ns else None
        why = self._refusals.of(item.name, now)
        state = "refused" if why is not None else _STATES.get(item.status, "missing")
        return FrameView(item.name, state, age, _pose_of(item), one_line(why or "", 100))

    def _newest_of_controller(self) -> ControllerState | None:
        message = self._controller.newest()
        return None if self._controller.silence > WORDS_LAST else message

    def _torques_in(self, message: ControllerState) -> tuple[TorqueView, ...]:
        """The torques of those joints that the robot has; none where the message holds others than it says."""
        parts = np.array(message.feedforward_torque), np.array(message.feedback_torque)
        if any(part.shape != (len(message.joints),) or not np.isfinite(part).all() for part in parts):
            return ()
        sent = dict(zip(message.joints, (float(torque) for torque in parts[0] + parts[1]), strict=True))
        return tuple(TorqueView(name, sent[name], *of) for name, of in self._limits.items() if name in sent)

    def _known_reference(self) -> ReferenceView | None:
        message = self._reference.newest()
        if message is None or self._reference.silence > STREAM_LASTS:
            return None
        covariance = np.array(message.pose.covariance).reshape(6, 6)
        return ReferenceView(conversions.pose_to_array(message.pose.pose), covariance)

    def _known_horizon(self) -> HorizonView | None:
        for message in self._ahead.take():
            self._horizon = _horizon_in(message)
        if self._ahead.silence > WORDS_LAST:
            self._horizon = None
        return self._horizon

    def _known_components(self) -> tuple[ComponentView, ...]:
        for array in self._markers.take():
            for marker in array.markers:
                if marker.ns != "components":
                    continue
                if marker.action == Marker.DELETE:
                    self._components.pop(marker.id, None)
                else:
                    size = np.array([marker.scale.x, marker.scale.y, marker.scale.z])
                    pose = conversions.pose_to_array(marker.pose)
                    self._components[marker.id] = ComponentView(pose, size, float(marker.color.a))
        if self._markers.silence > WORDS_LAST:
            self._components.clear()
        return tuple(self._components[number] for number in sorted(self._components))

    def _take_diagnostics(self) -> None:
        for array in self._diagnostics.take():
            for status in array.status:
                values = {item.key: item.value for item in status.values}
                name, now = status.name.rpartition("/")[2], time.monotonic()
                well = status.level == DiagnosticStatus.OK
                self._nodes[name] = now, NodeView(well, one_line(status.message, 300), values)
                if name == "frame_tracker":
                    self._refusals.take(values, now)


def _words_in(message: ControllerState) -> ControllerView:
    modes = {int(mode): mode.name for mode in ControllerMode}
    return ControllerView(modes.get(message.state, str(message.state)), one_line(message.reason, 300))


def _horizon_in(message: ReferenceMessage) -> HorizonView | None:
    """The path ahead; None where it is not one of poses."""
    try:
        reference = conversions.reference(message)
    except MessageError:  # as of any publisher on this topic
        return None
    gaussians = [reference.gaussian, *reference.horizon]
    if len(gaussians) < 2 or any(one.manifold != POSE for one in gaussians):
        return None
    return HorizonView(np.array([g.mean[:3] for g in gaussians]), np.array([g.covariance[:3, :3] for g in gaussians]))


def _stiffness_in(message: ControllerState) -> StiffnessView | None:
    """That of the hand; None where nothing is tracked, or what is tracked is no pose."""
    if len(message.stiffness) != 36:
        return None
    matrix = np.array(message.stiffness).reshape(6, 6)
    return StiffnessView(matrix) if np.isfinite(matrix).all() and matrix.any() else None


def _pose_of(item: TaskFrame) -> Array | None:
    """The pose of a frame; None where it has none, or is none of poses."""
    if item.status == TaskFrame.MISSING or item.rows != 7 or item.cols != 7 or len(item.a) != 49 or len(item.b) != 7:
        return None
    turn = np.array(item.a).reshape(7, 7)[:3, :3]
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6):
        return None
    return np.concatenate([np.array(item.b)[:3], quaternion.from_matrix(turn)])
