# SPDX-License-Identifier: Apache-2.0
"""impedance_controller: references and joint states in, joint torques out, stiff only where the task needs it.

Each joint state is answered by torques that carry its stamp. When joint states stop, a timer on the steady clock
sends the safe torque for some time. A lifecycle node: while it is not active, no torque; before that, the safe one.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState

from tpgmm_core.common.text import shown
from tpgmm_core.control.controller import TorqueCommand
from tpgmm_core.control.laws import CONFIGS, LAWS, LawSettings, LawTarget, ReferenceLaw
from tpgmm_core.control.planning import at_once
from tpgmm_core.control.supervised_controller import Answer, SupervisedController
from tpgmm_core.control.supervision import ControllerMode, Timeouts, slow_states
from tpgmm_core.control.torque_pipeline import TorqueLimits
from tpgmm_core.control.yielding import YieldConfig
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.joint_states import JointSample
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointStates, MessageError
from tpgmm_ros.messages.joint_state_bytes import JointStateDecoder, JointStateValues
from tpgmm_ros.messages.lockstep import Barrier
from tpgmm_ros.messages.qos import LATCHED, STATES, STREAM
from tpgmm_ros.messages.torque_outputs import OUTPUTS, TorqueOutputs
from tpgmm_ros.messages.values import StampedReference
from tpgmm_ros.nodes.controller_status import TorqueStatus, limited, loop_values
from tpgmm_ros.nodes.felt_force import FeltForce
from tpgmm_ros.nodes.joint_states import JOINT_STATE_RATE, SPREAD
from tpgmm_ros.runtime.background import Background
from tpgmm_ros.runtime.batches import Batches
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.lifecycle import ManagedNode
from tpgmm_ros.runtime.local_topics import receive_values
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters, declared_of, fill
from tpgmm_ros.runtime.timing import clock_trouble, loop_clock

PARAMETERS = [
    Declared("robot_file", "", "Robot file (YAML): URDF, end points, limits", fixed=True),
    Declared("law", "infinite_horizon", f"Control law: {', '.join(LAWS)}", fixed=True),
    Declared("endpoint", "left", "End point (hand) that follows pose references", fixed=True),
    JOINT_STATE_RATE,
    SPREAD,
    Declared("autostart", False, "Configure and activate at start, without a lifecycle manager", fixed=True),
    Declared(
        "lockstep",
        False,
        "Lockstep: answer each joint state once the reference with the same stamp has arrived",
        fixed=True,
    ),
    Declared(
        "torque_outputs",
        ["joint_state"],
        f"Messages in which torques are sent, any of {', '.join(OUTPUTS)}",
        fixed=True,
    ),
    Declared("torque_joints", "", "Joint group whose torques are sent, in its order; empty: all joints", fixed=True),
    Declared(
        "gravity_compensated", False, "The robot compensates gravity itself: leave gravity torques out", fixed=True
    ),
    *declared_of(Timeouts),
    *{item.name: item for config in CONFIGS for item in declared_of(config)}.values(),
    *declared_of(TorqueLimits),
    *declared_of(YieldConfig),
]
#: How often silence is looked for, and the safe torque sent meanwhile, s.
WATCH_PERIOD = 0.005
#: Step of the last torques, which lead to the safe one, s; and how long that may take.
RELEASE_STEP, RELEASE_TIME = 0.001, 0.2


class ImpedanceControllerNode(ManagedNode):
    """Answers joint states with the torques of the core's `SupervisedController`."""

    def __init__(self) -> None:
        super().__init__("impedance_controller")
        # Every value may be in its range and the whole still make no sense.
        self.parameters = Parameters(self, PARAMETERS, check=self._check_parameters, changed=self._reconfigure)
        self.law: ReferenceLaw | None = None
        self._background, self.status = Background(self), TorqueStatus(self)
        self.monitor = Monitor(self, self._status, self.parameters["joint_state_rate"], self._doubts)
        self._active = False
        if self.parameters["autostart"]:
            self.start_itself()

    @staticmethod
    def _check_parameters(values: Mapping[str, Any]) -> None:
        if values["law"] not in LAWS:
            raise ValueError(f"law is {shown(values['law'])}, expected one of {', '.join(LAWS)}")
        LawSettings.filled(lambda config: fill(config, values))

    def _make_law(self) -> ReferenceLaw:
        # in lockstep the same numbers, however long a plan takes
        submit = at_once if self.parameters["lockstep"] else self._background.submit
        settings = LawSettings.filled(self.parameters.fill)
        return ReferenceLaw(self.parameters["law"], self.robot, self.parameters["endpoint"], settings, submit)

    def _reconfigure(self) -> None:
        if self.law is not None:
            self.law.configure(LawSettings.filled(self.parameters.fill))
            fill = self.parameters.fill
            self.controller.configure(fill(TorqueLimits), fill(Timeouts), fill(YieldConfig))
            self._force.listen()

    # -- lifecycle ----------------------------------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the robot, make the law and subscribe; FAILURE where that cannot be done, with the reason in the log."""
        super().on_configure(state)
        try:
            self.robot = RobotModel.from_file(self.parameters.file("robot_file"))
            self.law = self._make_law()
            self._outputs = TorqueOutputs(
                self,
                self.robot,
                self.parameters["torque_outputs"],
                self.parameters["torque_joints"],
                self.parameters["gravity_compensated"],
            )
        except (ValueError, OSError, ImportError) as error:
            return self.refuse(error)
        limits, timeouts = self.parameters.fill(TorqueLimits), self.parameters.fill(Timeouts)
        for text in slow_states(
            1.0 / self.parameters["joint_state_rate"], "joint_state_rate", timeouts, limits.max_time_step
        ):
            self.get_logger().warning(text)
        self.controller: SupervisedController[LawTarget] = SupervisedController(
            self.robot,
            self.law,
            limits,
            timeouts,
            self.parameters.fill(YieldConfig),
            period=1.0 / self.parameters["joint_state_rate"],
            # between two of these messages the robot answers its own state, of now
            closed_elsewhere=self.parameters["torque_outputs"] == ["linear_feedback_controller"],
        )
        self._names = list(self.robot.joint_names)
        self._joint_states = JointStates(self._names, ("position", "velocity"), self.parameters[SPREAD.name])
        self._force = FeltForce(self, self.robot, self.parameters["endpoint"], self.controller)
        self._loop_clock = loop_clock(self)
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        states = self.create_lifecycle_publisher(ControllerState, "controller_state", LATCHED)
        self.status.begin(states, self.robot.base_frame)
        references = self.create_subscription(ReferenceMessage, "reference", self._take_reference, STREAM)
        receive_values(references, self._take_stamped_reference)
        Batches(self, JointState, "joint_states", self._take_states, STATES, JointStateDecoder())
        # The steady clock, also under simulated time: it calls even where that stands still. Ages are the loop clock's.
        self.create_timer(WATCH_PERIOD, self._watch, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return TransitionCallbackReturn.SUCCESS

    def _doubts(self) -> list[str]:
        """What is wrong with joint states, such as a rate that the settings are not made for."""
        return self.controller.doubts if self._active else []

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to answer joint states, with nothing known of references from before."""
        result = super().on_activate(state)
        self.controller.start()
        self._joint_states.forget()
        self._barrier = Barrier(("reference",), self._answer) if self.parameters["lockstep"] else None
        self.status.forget()
        self._active = True
        self.status.change(ControllerMode.WAITING, self.controller.decision.reason, self._loop_clock.now().nanoseconds)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lead the torques to the safe one, and send no more."""
        self._let_go()
        return super().on_deactivate(state)

    def destroy_node(self) -> None:
        """Lead the torques to the safe one, then end."""
        self._let_go()
        self._background.close()
        super().destroy_node()

    def _let_go(self) -> None:
        """The last torques lead to the safe one: what the robot is left with until its own watchdog takes over."""
        if not self._active:
            return
        end = time.monotonic() + RELEASE_TIME
        last = False
        while not last and time.monotonic() < end:
            time.sleep(RELEASE_STEP)
            command, last = self.controller.release(RELEASE_STEP)
            if command is not None:
                self._publish(command, self.controller.stamp_ns)
        self._active = False
        if self.status.actions:
            self.get_logger().info(f"torques were limited: {limited(self.status.actions)}")
        self.status.end(self._loop_clock.now().nanoseconds)

    # -- inputs -------------------------------------------------------------------------------------------------------

    def _take_reference(self, message: ReferenceMessage) -> None:
        """The reference of another process."""
        if not self._active:
            return
        try:
            stamped = StampedReference.of(message, lockstep=self._barrier is not None)
        except ValueError as error:
            self._refuse_reference(error)
            stamped = StampedReference(None, conversions.time_to_ns(message.header.stamp), "")
        self._take_stamped_reference(stamped)

    def _take_stamped_reference(self, stamped: StampedReference) -> None:
        if not self._active:
            return
        if stamped.reference is not None:
            self._follow_reference(stamped, stamped.reference)
        if self._barrier is not None:
            self._barrier.came("reference", stamped.stamp_ns)

    def _follow_reference(self, stamped: StampedReference, reference: Reference) -> None:
        now_ns, clock_ns = self._times(stamped.stamp_ns)
        try:
            stamped.require_frame(self.robot.base_frame)
            self.controller.take_reference(reference, stamped.stamp_ns, now_ns, clock_ns)
        except ValueError as error:
            self._refuse_reference(error)
            return
        if self._barrier is None and (answer := self.controller.answer_again(now_ns)) is not None:
            self._publish(answer.command, answer.stamp_ns)

    def _refuse_reference(self, error: ValueError) -> None:
        self.controller.refuse_reference(str(error))
        self.get_logger().error(f"reference refused: {error}", throttle_duration_sec=1.0)

    def _take_states(self, messages: Sequence[JointStateValues]) -> None:
        """All that wait, since a state may come in parts; the newest state is answered, others would be too late."""
        samples = [sample for sample in map(self._sample, messages) if sample is not None] if self._active else []
        if not samples:
            return
        if self._barrier is None:
            self._answer(*reversed(samples))
        else:
            self._barrier.take(samples[-1], samples[-1].stamp_ns)

    def _sample(self, message: JointStateValues) -> JointSample | None:
        """The state that a message completes, if it completes one."""
        try:
            sample = self._joint_states.take(message)
        except MessageError as error:
            now_ns, _ = self._times(message.stamp_ns)
            self._report(self.controller.refuse_state(str(error), message.stamp_ns, now_ns), now_ns)
            return None
        if sample is None:  # joints of others, or a part of the state
            self.controller.miss_state(self._joint_states.incomplete)
        self._force.take(message, sample)
        return sample

    def _times(self, stamp_ns: int) -> tuple[int, int]:
        """The clock that watches, and that of the stamps, ns, when a message came."""
        clock_ns = self.get_clock().now().nanoseconds
        if self._barrier is not None:  # in lockstep time waits for the answer: nothing is older than its stamp says
            clock_ns = min(clock_ns, stamp_ns)
        if self._simulated:  # the same clock, and /clock and the message of the same moment race each other
            return max(clock_ns, stamp_ns), clock_ns
        return self._loop_clock.now().nanoseconds, clock_ns

    # -- one step -----------------------------------------------------------------------------------------------------

    def _answer(self, newest: JointSample, *before: JointSample) -> None:
        """Answer the newest state; one before it, newest first, where that is of another robot."""
        start = time.perf_counter()
        self.monitor.tick(newest.stamp_ns)
        for sample in (newest, *before):
            now_ns, clock_ns = self._times(sample.stamp_ns)
            q, v = sample.values
            self._force.feel(now_ns)
            answer = self.controller.take_state(q, v, sample.stamp_ns, now_ns, clock_ns)
            if answer is not None:
                break
        self._report(answer, now_ns)
        if (age := self.controller.guard.age.age) is not None:
            self.status.ages.add(age)
        if answer is not None:
            self.monitor.done += 1
            self.monitor.step.add(time.perf_counter() - start)

    def _watch(self) -> None:
        """Joint states may have stopped, which no message tells."""
        if not self._active:
            return
        now_ns = self._loop_clock.now().nanoseconds
        if now_ns:
            self._report(self.controller.watch(now_ns), now_ns)
        elif not self.controller.stamp_ns:  # a simulated clock that has not come yet
            self.status.change(ControllerMode.WAITING, clock_trouble(self), now_ns)

    def _report(self, answer: Answer | None, now_ns: int) -> None:
        """Send torques, if any, and tell what is done and why."""
        if answer is not None:
            self._publish(answer.command, answer.stamp_ns)
        decision = self.controller.decision
        self.status.change(decision.mode, decision.reason, now_ns)
        if answer is not None:
            self.status.tell(answer.command, self._names, now_ns)

    def _publish(self, command: TorqueCommand, stamp_ns: int) -> None:
        self._outputs.publish(command, stamp_ns)
        self.status.actions.update(command.actions)

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        values = {"torques_limited": limited(self.status.actions)}
        if self._active:
            values |= loop_values(self.controller.guard, self.status.ages) | self._force.values()
        if self.law is not None and self.law.plan_age is not None:
            values["plan_age_ms"] = f"{1e3 * self.law.plan_age:.1f}"
        return self.status.diagnosis(values)


def main() -> int:
    """Run the node; returns the exit status."""
    return run(ImpedanceControllerNode)


if __name__ == "__main__":
    sys.exit(main())
