# SPDX-License-Identifier: Apache-2.0
"""baxter_simulator: joint torques and external wrenches in, joint states and end point poses out.

A hand can also be led to a pose, by a spring as soft as a person's arm.

In real time it makes one step per tick of the steady clock. In lockstep it publishes ``/clock``, waits for the torques
that answer each state (they carry its stamp), and goes on at once: as fast as the controller can.
"""

from __future__ import annotations

import functools
import sys
import time
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import Executor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from tpgmm_core.common.types import Array
from tpgmm_core.observation.poses import check_pose, wrong_frame
from tpgmm_core.observation.streams import SECOND, Stamp, StreamWatch
from tpgmm_core.robot.led_hand import LedHand
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.broadcasting import RobotBroadcaster
from tpgmm_ros.messages.conversions import JointReader, MessageError
from tpgmm_ros.messages.joint_messages import joint_state_of_values
from tpgmm_ros.messages.joint_state_bytes import JointStateValues
from tpgmm_ros.messages.qos import EVENTS, MIXED, STREAM
from tpgmm_ros.nodes.joint_states import BROADCAST_ROBOT
from tpgmm_ros.runtime.executor import StopFlag, run
from tpgmm_ros.runtime.local_topics import publish_value
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters

PARAMETERS = [
    Declared("robot_file", "", "Robot file (YAML): URDF, end points, limits", fixed=True),
    Declared("lockstep", False, "Lockstep: publish /clock and wait for the torques that answer each state", fixed=True),
    Declared("lockstep_wrench", False, "Lockstep: wait also for an external wrench in answer to each pose", fixed=True),
    Declared(
        "real_time_factor",
        0.0,
        "Lockstep: largest number of simulated seconds per second; 0: as fast as possible",
        0.0,
        100.0,
    ),
    Declared("rate", 1000.0, "Joint states per second of simulated time, Hz", 100.0, 2000.0, fixed=True),
    Declared("physics_steps", 1, "Physics steps from one joint state to the next", 1, 20, fixed=True),
    Declared("pose_rate", 100.0, "End point poses per second of simulated time, Hz", 1.0, 1000.0, fixed=True),
    BROADCAST_ROBOT,
    Declared("command_timeout", 0.1, "Time without torques after which the robot brakes, s", 0.002, 10.0),
    Declared("braking_rate", 20.0, "Rate at which the robot brakes while no torques come, 1/s", 0.0, 50.0),
    Declared(
        "wrench_timeout",
        0.2,
        "Time after which an external wrench, or guiding a hand, ends unless repeated, s",
        0.002,
        10.0,
    ),
]

#: Torques answer joint states: none may be stamped so far ahead of the newest one, s.
MAX_FUTURE = 0.05
#: In lockstep, a state without an answer is published again after this long, s: best effort may lose a message.
REPEAT_AFTER = 0.1
#: In lockstep, Hz of simulated time: every node hears the clock, and what is to be exact has a stamp of its own.
CLOCK_RATE = 100.0
#: Events that are served in each tick, however late it is.
SERVED_AT_LEAST = 3
#: After a pause (a suspended process) time is let go of rather than simulated in one go, ticks.
MAX_CATCH_UP = 50


@dataclass(slots=True)
class _Push:
    wrench: Array
    received: float  # simulated s


@dataclass(slots=True)
class _Lead:
    aim: Array
    received: float  # simulated s
    person: LedHand


class BaxterSimulatorNode(Node):
    """A robot that obeys torques, simulated by the core's `RobotSimulator`."""

    def __init__(self) -> None:
        super().__init__("baxter_simulator")
        self.parameters = Parameters(self, PARAMETERS)
        self.robot = RobotModel.from_file(self.parameters.file("robot_file"))
        self.time_step = 1.0 / self.parameters["rate"]
        self._physics_steps: int = self.parameters["physics_steps"]
        self.simulator = RobotSimulator(self.robot, time_step=self.time_step / self._physics_steps)
        self._data = self.robot.create_data()
        self.lockstep: bool = self.parameters["lockstep"]
        self._steps_per_pose = max(1, round(self.parameters["rate"] / self.parameters["pose_rate"]))
        self._steps_per_clock = max(1, round(self.parameters["rate"] / CLOCK_RATE))
        self._names = list(self.robot.joint_names)
        self._reader = JointReader(self._names)
        self._steps = 0
        self._stamp_ns = 0
        self._torque: Array | None = None
        self._torque_stamp_ns = -1
        self._torque_watch = StreamWatch()
        self._torque_received = 0.0  # simulated s
        self._pushes: dict[str, _Push] = {}
        self._leads: dict[str, _Lead] = {}
        self._wrench_stamp_ns = -1
        self._pose_stamp_ns = 0
        self._states = self.create_publisher(JointState, "joint_states", STREAM)
        self._poses = {
            name: self.create_publisher(PoseStamped, f"endpoint/{name}/pose", STREAM) for name in self.robot.endpoints
        }
        self._shown = RobotBroadcaster(self, self.robot) if self.parameters[BROADCAST_ROBOT.name] else None
        self._clock_publisher = self.create_publisher(Clock, "/clock", EVENTS) if self.lockstep else None
        self.create_subscription(JointState, "joint_torques", self._take_torques, STREAM)
        self.create_subscription(WrenchStamped, "external_wrench", self._take_wrench, MIXED)
        for name in self.robot.endpoints:
            self.create_subscription(PoseStamped, f"lead/{name}/pose", functools.partial(self._take_lead, name), STREAM)
        self.monitor = Monitor(self, self._status)

    # -- inputs -------------------------------------------------------------------------------------------------------

    def _take_torques(self, message: JointState) -> None:
        try:
            (torque,) = self._reader.read(message, "effort")
        except MessageError as error:
            self.get_logger().error(f"torques refused: {error}", throttle_duration_sec=1.0)
            return
        stamp_ns, now_ns = conversions.time_to_ns(message.header.stamp), round(SECOND * self.simulator.state.time)
        if self.lockstep and stamp_ns != self._stamp_ns:
            return  # time stands still until this state is answered: what answers another one must not stand for it
        # repeated ones count: a controller that hears nothing goes on by the stamp of the last state
        kind = self._torque_watch.judge(
            stamp_ns, now_ns, self._stamp_ns, self.parameters["command_timeout"], MAX_FUTURE
        )
        if kind is Stamp.FUTURE:
            self.get_logger().error(
                f"torques refused: their stamp lies more than {MAX_FUTURE:g} s ahead of the newest joint state",
                throttle_duration_sec=1.0,
            )
        if kind in (Stamp.FUTURE, Stamp.OLD):
            return
        self._torque_watch.accept(stamp_ns, now_ns)
        self._torque, self._torque_stamp_ns, self._torque_received = torque, stamp_ns, self.simulator.state.time

    def _take_wrench(self, message: WrenchStamped) -> None:
        link = message.header.frame_id
        try:
            self.robot.frame_id(link)
            self._pushes[link] = _Push(conversions.wrench_to_array(message), self.simulator.state.time)
            self._wrench_stamp_ns = conversions.time_to_ns(message.header.stamp)
        except ValueError as error:
            self.get_logger().error(f"wrench refused: {error}", throttle_duration_sec=1.0)

    def _take_lead(self, endpoint: str, message: PoseStamped) -> None:
        if message.header.frame_id == self.robot.endpoints[endpoint].frame:  # in its own frame a hand is where it is
            self._leads.pop(endpoint, None)
            return
        pose, reason = check_pose(conversions.pose_to_array(message.pose))
        reason = wrong_frame(message.header.frame_id, self.robot.base_frame) or reason
        if pose is None or reason:
            self.get_logger().error(f"leading the hand {endpoint} refused: {reason}", throttle_duration_sec=1.0)
            return
        now = self.simulator.state.time
        if endpoint in self._leads:
            self._leads[endpoint].aim, self._leads[endpoint].received = pose, now
        else:
            self._data.update(self.simulator.state.q)
            self._leads[endpoint] = _Lead(pose, now, LedHand(self._data.pose(endpoint)))

    def _led(self, now: float, timeout: float) -> dict[str, Array]:
        """Forces of those who lead hands, by the links of these."""
        self._leads = {name: lead for name, lead in self._leads.items() if now - lead.received <= timeout}
        if not self._leads:
            return {}
        self._data.update(self.simulator.state.q, self.simulator.state.v)
        return {
            self.robot.endpoints[name].frame: lead.person.wrench(
                self.time_step, lead.aim, self._data.pose(name), self._data.twist(name)
            )
            for name, lead in self._leads.items()
        }

    # -- one step -----------------------------------------------------------------------------------------------------

    def _step(self) -> None:
        now = self.simulator.state.time
        timeout = self.parameters["wrench_timeout"]
        self._pushes = {link: push for link, push in self._pushes.items() if now - push.received <= timeout}
        wrenches = {link: push.wrench for link, push in self._pushes.items()}
        for link, wrench in self._led(now, timeout).items():
            wrenches[link] = wrenches[link] + wrench if link in wrenches else wrench
        torque = self._live_torque()
        for _ in range(self._physics_steps):
            self.simulator.step(self._braking() if torque is None else torque, wrenches)
        self._steps += 1

    def _live_torque(self) -> Array | None:
        """The commanded torques, unless there are none or they are older than ``command_timeout``."""
        silence = self.simulator.state.time - self._torque_received
        return None if silence > self.parameters["command_timeout"] else self._torque

    def _braking(self) -> Array:
        """What the robot does by itself when nobody commands it: carry its weight, and slow down, all joints alike.

        Baxter goes into position control then and holds its joints; ours may still be pushed about.
        """
        state = self.simulator.state
        # With their inertia, since what stops a shoulder is far too much for a finger
        braking = self._data.mass_matrix(state.q) @ (self.parameters["braking_rate"] * state.v)
        return self._data.nonlinear_effects(state.q, state.v) - braking

    def _publish_clock(self) -> None:
        assert self._clock_publisher is not None
        self._clock_publisher.publish(Clock(clock=conversions.time_from_ns(self._stamp_ns)))

    def _publish_state(self) -> None:
        state = self.simulator.state
        values = JointStateValues(self._stamp_ns, self._names, state.q, state.v, state.tau)
        publish_value(self._states, values, joint_state_of_values)

    def _publish_poses(self) -> None:
        if self._steps % self._steps_per_pose == 0:
            self._pose_stamp_ns = self._stamp_ns
            self._data.update(self.simulator.state.q)
            self._last_poses = {
                name: conversions.pose_stamped(self._data.pose(name), self._stamp_ns, self.robot.base_frame)
                for name in self._poses
            }
            self._send_poses()
            if self._shown is not None:
                self._shown.send(self._data, self._stamp_ns)

    def _send_poses(self) -> None:
        for name, message in self._last_poses.items():
            self._poses[name].publish(message)

    # -- loops --------------------------------------------------------------------------------------------------------

    def loop(self, executor: Executor, stop: StopFlag) -> None:
        """Simulate until told to stop."""
        if self.lockstep:
            self._run_lockstep(executor, stop)
        else:
            self._run_real_time(executor, stop)

    def _run_real_time(self, executor: Executor, stop: StopFlag) -> None:
        tick = time.perf_counter()
        while not stop.set:
            tick += self.time_step
            # Also where the machine is too slow and no time remains: torques, services and diagnostics want their turn
            for _ in range(SERVED_AT_LEAST):
                executor.spin_once(timeout_sec=0.0)
            while (remaining := tick - time.perf_counter()) > 0.0:
                executor.spin_once(timeout_sec=remaining)
            start = time.perf_counter()
            behind = int((start - tick) / self.time_step)
            tick += behind * self.time_step
            self._stamp_ns = self.get_clock().now().nanoseconds
            if self._live_torque() is not None:
                self.monitor.age.add(1e-9 * (self._stamp_ns - self._torque_stamp_ns))
            for _ in range(min(1 + behind, MAX_CATCH_UP)):
                self._step()
            self._publish_state()
            self._publish_poses()
            self.monitor.asked += 1 + behind
            self.monitor.done += 1
            self.monitor.step.add(time.perf_counter() - start)

    def _run_lockstep(self, executor: Executor, stop: StopFlag) -> None:
        due = time.perf_counter()
        while not stop.set:
            if factor := self.parameters["real_time_factor"]:
                # what was lost is not made up for: time then passes more slowly
                due = max(due + self.time_step / factor, time.perf_counter() - MAX_CATCH_UP * self.time_step / factor)
                while (remaining := due - time.perf_counter()) > 0.0 and not stop.set:
                    executor.spin_once(timeout_sec=remaining)
            # Simulated time starts at 1 s: in ROS, zero means that time is not known yet.
            self._stamp_ns = SECOND + round(self._steps * self.time_step * SECOND)
            if self._steps % self._steps_per_clock == 0:
                self._publish_clock()
            self._publish_state()
            self._publish_poses()
            # Nodes in this process have answered by now; services and whatever else still want their turn
            executor.spin_once(timeout_sec=0.0)
            repeat_at = time.perf_counter() + REPEAT_AFTER
            while not (self._is_answered() or stop.set):
                executor.spin_once(timeout_sec=0.01)
                if time.perf_counter() > repeat_at:
                    self._publish_clock()  # who came later, or knew an earlier simulator, has to learn when it is
                    self._publish_state()
                    self._send_poses()  # also those of an earlier step, which a node that was started again never got
                    repeat_at += REPEAT_AFTER
            start = time.perf_counter()
            self._step()
            self.monitor.asked += 1
            self.monitor.done += 1
            self.monitor.step.add(time.perf_counter() - start)

    def _is_answered(self) -> bool:
        """Whether all have answered this step: the controller each state, whoever leads the robot each pose."""
        led = not self.parameters["lockstep_wrench"] or self._wrench_stamp_ns >= self._pose_stamp_ns
        return led and self._torque_stamp_ns == self._stamp_ns

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        values = {"simulated_time_s": f"{self.simulator.state.time:.3f}"}
        if self._torque is None:
            return DiagnosticStatus.WARN, "no torques yet: the robot brakes", values
        if self._live_torque() is None:
            return DiagnosticStatus.WARN, "torques stopped: the robot brakes", values
        return DiagnosticStatus.OK, "driven by torques", values


def main() -> int:
    """Run the node; returns the exit status."""
    return run(BaxterSimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
