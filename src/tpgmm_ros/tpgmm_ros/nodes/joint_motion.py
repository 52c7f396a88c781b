# SPDX-License-Identifier: Apache-2.0
"""joint_motion: references and joint states in; positions of joints, or poses and velocities of a hand, out.

For robots without torques. At its `command_rate` it sends what `outputs` name, within limits of position, speed and
acceleration; where these act, what the reference is less sure of gives way. It begins at the measured joints of a robot
that rests, and never jumps: where references or joint states stop, or the robot does not follow, the joints slow
down and stay, and the reason is on `/diagnostics`. A lifecycle node: while it is not active, nothing is sent.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState

from tpgmm_core.common.text import listed, shown
from tpgmm_core.control.hand_stiffness import StiffnessConfig, hand_stiffness
from tpgmm_core.control.joint_motion import JointStep, MotionConfig
from tpgmm_core.control.motion_aims import Aim
from tpgmm_core.control.supervised_motion import MotionTimeouts, SupervisedMotion
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages.conversions import JointStates, MessageError
from tpgmm_ros.messages.joint_state_bytes import JointStateDecoder, JointStateValues
from tpgmm_ros.messages.motion_outputs import ACTION, NAMES, OF_JOINTS, Motion, MotionOutputs, check_outputs
from tpgmm_ros.messages.qos import LATCHED, STATES, STREAM
from tpgmm_ros.messages.values import StampedReference
from tpgmm_ros.nodes.controller_status import ControllerStatus
from tpgmm_ros.nodes.joint_states import SPREAD
from tpgmm_ros.nodes.trajectory_goals import TrajectoryGoals
from tpgmm_ros.runtime.batches import Batches
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.lifecycle import ManagedNode
from tpgmm_ros.runtime.local_topics import receive_values
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters, declared_of, fill
from tpgmm_ros.runtime.timing import clock_trouble, loop_clock

PARAMETERS = [
    Declared("robot_file", "", "Robot file (YAML): URDF, end points, limits", fixed=True),
    Declared("endpoint", "left", "End point (hand) that follows pose references", fixed=True),
    Declared(
        "joints",
        "",
        "Joint group that is moved, in the order of the positions; empty: the group of the end point",
        fixed=True,
    ),
    Declared("outputs", ["joint_trajectory"], f"Outputs that are sent, any of {', '.join(NAMES)}", fixed=True),
    Declared("command_rate", 100.0, "Rate at which outputs are sent, Hz", 1.0, 1000.0, fixed=True),
    Declared(
        "horizon",
        0.03,
        "Time that the robot has to reach the first point of a trajectory, s: two to four periods of `command_rate`",
        0.001,
        1.0,
    ),
    SPREAD,
    Declared("autostart", False, "Configure and activate at start, without a lifecycle manager", fixed=True),
    *declared_of(MotionConfig),
    *declared_of(MotionTimeouts),
    *declared_of(StiffnessConfig),
]
CONFIGS = (MotionConfig, MotionTimeouts, StiffnessConfig)
#: How much longer than the joints need the end may take, s.
RELEASE_TIME = 0.5


class JointMotionNode(ManagedNode):
    """Sends what the core's `SupervisedMotion` says, at a steady rate."""

    def __init__(self) -> None:
        super().__init__("joint_motion")
        self.motion: SupervisedMotion | None = None
        self._goals: TrajectoryGoals | None = None
        self._active = False
        self.status = ControllerStatus(self)
        self.parameters = Parameters(self, PARAMETERS, check=self._check, changed=self._reconfigure)
        self.monitor = Monitor(self, self._status, self.parameters["command_rate"])
        if self.parameters["autostart"]:
            self.start_itself()

    @staticmethod
    def _check(values: Mapping[str, Any]) -> None:
        check_outputs(values["outputs"])
        for config in CONFIGS:
            fill(config, values)

    def _reconfigure(self) -> None:
        if self.motion is not None:
            self.motion.configure(self.parameters.fill(MotionConfig), self.parameters.fill(MotionTimeouts))
            self._stiffness = self.parameters.fill(StiffnessConfig)

    # -- lifecycle ----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the robot and subscribe; FAILURE where that cannot be done, with the reason in the log."""
        super().on_configure(state)
        try:
            self.robot = RobotModel.from_file(self.parameters.file("robot_file"))
            self.motion = self._make_motion(self.robot)
            self._outputs = MotionOutputs(self, self.parameters["outputs"])
            if ACTION in self.parameters["outputs"]:
                self._goals = TrajectoryGoals(self, self.motion.refuse_motion)
        except (ValueError, OSError, ImportError) as error:
            return self.refuse(error)
        self._stiffness = self.parameters.fill(StiffnessConfig)
        self._joint_states = JointStates(self.robot.joint_names, ("position",), self.parameters[SPREAD.name])
        self._loop_clock = loop_clock(self)
        states = self.create_lifecycle_publisher(ControllerState, "controller_state", LATCHED)
        self.status.begin(states, self.robot.base_frame)
        references = self.create_subscription(ReferenceMessage, "reference", self._take_reference, STREAM)
        receive_values(references, self._take_stamped_reference)
        Batches(self, JointState, "joint_states", self._take_states, STATES, JointStateDecoder())
        self.create_timer(1.0 / self.parameters["command_rate"], self._step, clock=self._loop_clock)
        return TransitionCallbackReturn.SUCCESS

    def _make_motion(self, robot: RobotModel) -> SupervisedMotion:
        endpoint, group = self.parameters["endpoint"], self.parameters["joints"]
        if endpoint not in robot.endpoints:
            raise ValueError(f"the robot has no end point {shown(endpoint)}; it has {listed(robot.endpoints)}")
        if group and group not in robot.joint_groups:
            raise ValueError(
                f"joints names no joint group of the robot file: {shown(group)}; it has {listed(robot.joint_groups)}"
            )
        joints = robot.indices(group or robot.endpoints[endpoint].joints)
        configs = self.parameters.fill(MotionConfig), self.parameters.fill(MotionTimeouts)
        by_pose = not set(self.parameters["outputs"]) & set(OF_JOINTS)
        return SupervisedMotion(robot, endpoint, joints, *configs, by_pose)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for joint states and a reference, with nothing known from before."""
        result = super().on_activate(state)
        assert self.motion is not None
        self.motion.start()
        self._joint_states.forget()
        self._active = True
        self._tell()
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the action too."""
        if self._goals is not None:
            self._goals.destroy()
        return super().on_cleanup(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lead the joints to rest, and send no more."""
        self._let_go()
        return super().on_deactivate(state)

    def destroy_node(self) -> None:
        """Lead the joints to rest, then end."""
        self._let_go()
        super().destroy_node()

    def _let_go(self) -> None:
        if not self._active or self.motion is None:
            return
        period = 1.0 / self.parameters["command_rate"]
        begin = time.monotonic()
        end = begin + self.motion.motion.stop_point()[1] + RELEASE_TIME
        now_ns = self._loop_clock.now().nanoseconds
        while time.monotonic() < end:
            time.sleep(period)
            # simulated time may stand still by now: what passes here is the time of the wall
            step = self.motion.release(now_ns + round(1e9 * (time.monotonic() - begin)))
            if step is None:
                break
            self._send(step)
        self._active = False
        self.status.end(time.monotonic_ns())

    # -- inputs -------------------------------------------------------------------------------------------------------

    def _take_reference(self, message: ReferenceMessage) -> None:
        """The reference of another process."""
        if not self._active:
            return
        try:
            self._take_stamped_reference(StampedReference.of(message))
        except ValueError as error:
            self._refuse_reference(error)

    def _take_stamped_reference(self, stamped: StampedReference) -> None:
        if not self._active or self.motion is None or stamped.reference is None:
            return
        try:
            stamped.require_frame(self.robot.base_frame)
            aim = Aim.of_reference(self.robot, self.motion.endpoint, stamped.reference)
            self.motion.take_reference([aim], stamped.stamp_ns, *self._times())
        except ValueError as error:
            self._refuse_reference(error)

    def _refuse_reference(self, error: ValueError) -> None:
        if self.motion is not None:
            self.motion.refuse_reference(str(error))
        self.get_logger().error(f"reference refused: {error}", throttle_duration_sec=1.0)

    def _take_states(self, messages: Sequence[JointStateValues]) -> None:
        if not self._active or self.motion is None:
            return
        for message in messages:
            try:
                sample = self._joint_states.take(message)
            except MessageError as error:
                self.motion.refuse_state(str(error))
                continue
            if sample is not None:
                self.motion.take_state(sample.values[0], sample.stamp_ns, *self._times())
            else:  # joints of others, or a part of the state
                self.motion.miss_state(self._joint_states.incomplete)

    def _times(self) -> tuple[int, int]:
        """The clock that watches, and that of the stamps, ns."""
        return self._loop_clock.now().nanoseconds, self.get_clock().now().nanoseconds

    # -- one step -----------------------------------------------------------------------------------------------------

    def _step(self) -> None:
        if not self._active or self.motion is None:
            return
        start, now_ns = time.perf_counter(), self._loop_clock.now().nanoseconds
        self.monitor.tick(now_ns)
        if self._goals is not None and self._goals.is_waiting():
            return
        step = self.motion.step(now_ns, self._goals.why_not() if self._goals is not None else "")
        if step is not None:
            self._send(step)
            self.monitor.step.add(time.perf_counter() - start)
        self.monitor.done += 1
        self._tell()

    def _send(self, step: JointStep) -> None:
        assert self.motion is not None
        motion = self.motion.motion
        stop_q, stop_time = motion.stop_point()
        hands = [aim for aim in self.motion.aims if aim.endpoint]
        sent = Motion(
            joints=motion.names,
            q=step.q,
            v=step.v,
            horizon=self.parameters["horizon"],
            stop_q=stop_q,
            stop_time=stop_time,
            pose=motion.pose(self.motion.endpoint),
            twist=motion.twist(self.motion.endpoint),
            stiffness=hand_stiffness(hands[0].covariance, self._stiffness) if hands else None,
            stamp_ns=self.get_clock().now().nanoseconds,
            frame_id=self.robot.base_frame,
        )
        self._outputs.publish(sent)
        if self._goals is not None:
            self._goals.send(sent, self.motion.timeouts.max_lag)

    # -- what others are told -----------------------------------------------------------------------------------------

    def _tell(self) -> None:
        assert self.motion is not None
        self.status.change(self.motion.mode, self.motion.reason, time.monotonic_ns())

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        values = {}
        if self._active and self.motion is not None:
            values = self.motion.lag.values
        return self.status.diagnosis(values, clock_trouble(self) if self._active else "")


def main() -> int:
    """Run the node; returns the exit status."""
    return run(JointMotionNode)


if __name__ == "__main__":
    sys.exit(main())
