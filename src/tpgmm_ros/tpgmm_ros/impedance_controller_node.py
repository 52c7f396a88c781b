# SPDX-License-Identifier: Apache-2.0
"""impedance_controller: references and joint states in, joint torques out, stiff only where the task needs it.

Each joint state is answered by torques that carry its stamp. A lifecycle node: while it is not active, no torque.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState

from tpgmm_core.impedance import ImpedanceConfig, ImpedanceController, PoseReference, TorqueCommand
from tpgmm_core.reference import Reference
from tpgmm_core.robot import RobotModel
from tpgmm_core.supervision import ControllerMode, ReferenceTimeouts, mode_of
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros import conversions
from tpgmm_ros.conversions import JointReader, MessageError
from tpgmm_ros.executor import run
from tpgmm_ros.lifecycle import ManagedNode
from tpgmm_ros.monitor import Monitor
from tpgmm_ros.parameters import Declared, Parameters, declared_of, fill
from tpgmm_ros.qos import LATCHED, STREAM
from tpgmm_ros.timing import loop_clock

PARAMETERS = [
    Declared("robot_file", "", "Robot file (YAML): URDF, end points, limits", fixed=True),
    Declared("endpoint", "left", "The end point that follows the reference", fixed=True),
    Declared(
        "joint_state_rate", 1000.0, "Joint states that should come, Hz: lost ones are counted", 1.0, 10000.0, fixed=True
    ),
    Declared("autostart", False, "Configure and activate at start, without a lifecycle manager", fixed=True),
    Declared(
        "lockstep", False, "Wait for the reference of the same stamp before a joint state is answered", fixed=True
    ),
    *declared_of(ReferenceTimeouts),
    *declared_of(ImpedanceConfig),
]
STATE_PERIOD_NS = 100_000_000
SECOND = 1_000_000_000


class ImpedanceControllerNode(ManagedNode):
    def __init__(self) -> None:
        super().__init__("impedance_controller")
        # Every value may be in its range and the whole still make no sense.
        self.parameters = Parameters(
            self, PARAMETERS, check=lambda values: fill(ImpedanceConfig, values), changed=self._reconfigure
        )
        self.controller: ImpedanceController | None = None
        self.monitor = Monitor(self, self._status, self.parameters["joint_state_rate"])
        self._active = False
        self._mode, self._reason = ControllerMode.WAITING, "not active"
        if self.parameters["autostart"]:
            self.start_itself()

    def _reconfigure(self) -> None:
        if self.controller is not None:
            self.controller.configure(self.parameters.fill(ImpedanceConfig))

    # -- lifecycle ----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        super().on_configure(state)
        try:
            self.robot = RobotModel.from_file(self.parameters.file("robot_file"))
            self.controller = ImpedanceController(
                self.robot, self.parameters["endpoint"], self.parameters.fill(ImpedanceConfig)
            )
        except (ValueError, OSError) as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._names = list(self.robot.joint_names)
        self._reader = JointReader(self._names)
        self._loop_clock = loop_clock(self)
        self._torques = self.create_lifecycle_publisher(JointState, "joint_torques", STREAM)
        self._states = self.create_lifecycle_publisher(ControllerState, "controller_state", LATCHED)
        self.create_subscription(ReferenceMessage, "reference", self._take_reference, STREAM)
        self.create_subscription(JointState, "joint_states", self._take_state, STREAM)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_activate(state)
        assert self.controller is not None
        self.controller.reset()
        self._reference: Reference | None = None
        self._reference_stamp_ns = -1
        self._reference_ns = 0
        self._pending: JointState | None = None
        self._last_stamp_ns: int | None = None
        self._state_due_ns = 0
        self._active = True
        self._change(ControllerMode.WAITING, "no joint state yet")
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._active = False
        self._change(ControllerMode.WAITING, "not active")
        return super().on_deactivate(state)

    # -- inputs -------------------------------------------------------------------------------------------------------

    def _take_reference(self, message: ReferenceMessage) -> None:
        if not self._active:
            return
        try:
            reference = conversions.reference(message)
            if message.header.frame_id not in ("", self.robot.base_frame):
                raise MessageError(
                    f"the reference is expressed in '{message.header.frame_id}'; expected '{self.robot.base_frame}'"
                )
            if str(reference.gaussian.manifold) != "R3 x S3":
                raise MessageError(f"the reference is on '{reference.gaussian.manifold}'; expected a pose on 'R3 x S3'")
        except MessageError as error:
            self.get_logger().error(f"reference refused: {error}", throttle_duration_sec=1.0)
            return
        self._reference = reference
        self._reference_stamp_ns = conversions.time_to_ns(message.header.stamp)
        self._reference_ns = self._loop_clock.now().nanoseconds
        if self._pending is not None:
            self._answer(self._pending)

    def _take_state(self, message: JointState) -> None:
        if not self._active:
            return
        if self._must_wait(message):
            self._pending = message
        else:
            self._answer(message)

    def _must_wait(self, message: JointState) -> bool:
        """In lockstep, the reference that belongs to a state comes a moment after it."""
        if not self.parameters["lockstep"] or self._mode is not ControllerMode.ACTIVE:
            return False
        stamp = conversions.time_to_ns(message.header.stamp)
        # A state that comes again was answered by nobody: the reference is not coming.
        again = self._pending is not None and conversions.time_to_ns(self._pending.header.stamp) == stamp
        return self._reference_stamp_ns < stamp and not again

    # -- one step -----------------------------------------------------------------------------------------------------

    def _answer(self, message: JointState) -> None:
        self._pending = None
        start = time.perf_counter()
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        self.monitor.tick(stamp_ns)
        dt = 0.0 if self._last_stamp_ns is None else 1e-9 * (stamp_ns - self._last_stamp_ns)
        self._last_stamp_ns = stamp_ns
        try:
            q, v = self._reader.read(message, "position", "velocity")
            mode, reason, reference = self._pose_reference()
        except MessageError as error:
            mode, reason = ControllerMode.FAULT, f"joint state refused: {error}"
            self.get_logger().error(reason, throttle_duration_sec=1.0)
            # To a state that is unknown the controller's answer is to carry the weight where the robot was last.
            q = v = np.full(self.robot.nv, np.nan)
            reference = None
        assert self.controller is not None
        command = self.controller.step(q, v, reference, dt)
        self._torques.publish(conversions.joint_state_message(self._names, stamp_ns, effort=command.tau))
        self.monitor.done += 1
        self.monitor.step.add(time.perf_counter() - start)
        if command.reason and mode is not ControllerMode.FAULT:
            mode, reason = ControllerMode.FAULT, command.reason
        self._change(mode, reason)
        self._tell(command, stamp_ns)

    def _pose_reference(self) -> tuple[ControllerMode, str, PoseReference | None]:
        """What the controller is to follow now, by the age of the last reference, and why."""
        reference = self._reference
        age = None
        if reference is not None:
            age = (self._loop_clock.now().nanoseconds - self._reference_ns) / SECOND
        mode, reason = mode_of(age, self.parameters.fill(ReferenceTimeouts))
        if reference is None or mode is ControllerMode.DAMPING:
            return mode, reason, None
        twist = reference.velocity() if mode is ControllerMode.ACTIVE else np.zeros(6)
        return mode, reason, PoseReference(reference.gaussian.mean, reference.gaussian.covariance, twist)

    # -- what others are told -----------------------------------------------------------------------------------------

    def _change(self, mode: ControllerMode, reason: str) -> None:
        if (mode, reason) == (self._mode, self._reason):
            return
        self._mode, self._reason = mode, reason
        self._state_due_ns = 0
        self.get_logger().info(f"{mode.name}: {reason}")
        self._states.publish(self._state_message())

    def _state_message(self) -> ControllerState:
        message = ControllerState(state=int(self._mode), reason=self._reason)
        message.header.stamp = self.get_clock().now().to_msg()
        return message

    def _tell(self, command: TorqueCommand, stamp_ns: int) -> None:
        if 0 < self._state_due_ns - stamp_ns <= STATE_PERIOD_NS:
            return
        self._state_due_ns = stamp_ns + STATE_PERIOD_NS
        message = self._state_message()
        message.joints = self._names
        message.stiffness = conversions.floats(command.stiffness)
        message.damping = conversions.floats(command.damping)
        message.feedforward_torque = conversions.floats(command.feedforward)
        message.feedback_torque = conversions.floats(command.tau - command.feedforward)
        self._states.publish(message)

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        level = DiagnosticStatus.OK
        if self._mode is ControllerMode.FAULT:
            level = DiagnosticStatus.ERROR
        elif self._mode in (ControllerMode.HOLD, ControllerMode.WAITING):
            level = DiagnosticStatus.WARN
        return level, f"{self._mode.name}: {self._reason}", {}


def main() -> int:
    return run(ImpedanceControllerNode)


if __name__ == "__main__":
    sys.exit(main())
