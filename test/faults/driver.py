# SPDX-License-Identifier: Apache-2.0
"""A robot's driver as drivers are, during movements of the whole graph: late, out of order, in parts, beside others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from faults.controller_states import LEFT, OTHERS, gripper, part
from faults.graph_bench import RATE, GraphBench
from faults.table import fault
from ros_graph import ALL, SECOND, ros_arguments
from ros_testing import RunningProcess, StartProcess
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_ros import conversions
from tpgmm_ros.qos import STREAM

TICK_NS = round(SECOND / RATE)


class DriverBench(GraphBench):
    """The graph, with this process between the simulated robot's joint states and those who hear them.

    Attributes:
        drive: is given each joint state of the robot, and publishes what the driver makes of it.
    """

    name: ClassVar[str] = "driver"

    def __init__(self, node: Node, start: StartProcess, directory: Path) -> None:
        self._out = node.create_publisher(JointState, "joint_states", STREAM)
        self.publish = self._out.publish
        self.drive: Callable[[JointState], object] = self.publish
        node.create_subscription(JointState, "driver/joint_states", lambda message: self.drive(message), ALL)
        super().__init__(node, start, directory)

    def spare(self, name: str) -> RunningProcess:
        remapped = ["-r", "joint_states:=driver/joint_states"] if name == "baxter_simulator" else []
        return self._start(name, *ros_arguments(**self.parameters[name]), *remapped)

    def prepare(self) -> None:
        self.drive = self.publish
        super().prepare()

    def settle(self) -> str:
        self.drive = self.publish
        return super().settle()

    def moved(self) -> str:
        """A movement that ends well although; numbers."""
        result = self.result(self.move())
        assert result.success, result.reason
        speed = max(float(np.abs(message.velocity).max(initial=0.0)) for message in self.states.messages)
        others = [item for item in self.modes.messages if item.state != ControllerMode.ACTIVE]
        return (
            f"{result.reason}, at most {speed:.2f} rad/s, {len(others)} messages of other modes, {self.assert_sound()}"
        )


@fault(
    DriverBench,
    "one joint state in a hundred up to 10 ms late, after newer ones, during a movement",
    "overtaken ones are ignored by all: the movement ends well",
    quick=False,
)
def out_of_order(bench: DriverBench) -> str:
    rng = np.random.default_rng(0)
    held: list[tuple[int, JointState]] = []
    count = late = 0

    def drive(state: JointState) -> None:
        nonlocal count, late
        count += 1
        if rng.random() < 0.01:
            held.append((count + int(rng.integers(1, 6)), state))
            return
        bench.publish(state)
        for item in [item for item in held if item[0] <= count]:
            held.remove(item)
            late += 1
            bench.publish(item[1])

    bench.drive = drive
    observed = bench.moved()
    assert late > 5
    return f"{late} of {count} came late; {observed}"


@fault(
    DriverBench,
    "a gripper's driver publishes on the same topic at 50 Hz, its clock 20 ms ahead, during a movement",
    "no state, no tick, no fault of anybody: the movement ends well",
    quick=False,
)
def beside_a_gripper(bench: DriverBench) -> str:
    timer = bench.node.create_timer(0.02, lambda: bench.publish(gripper(bench.now_ns() + SECOND // 50)))
    try:
        return bench.moved()
    finally:
        bench.node.destroy_timer(timer)


@fault(
    DriverBench,
    "joint states in two messages from two drivers, during a movement",
    "complete states are answered: the movement ends well",
    quick=False,
)
def in_parts(bench: DriverBench) -> str:
    def drive(state: JointState) -> None:
        stamp_ns = conversions.time_to_ns(state.header.stamp)
        bench.publish(part(state, OTHERS, stamp_ns))
        bench.publish(part(state, LEFT, stamp_ns + TICK_NS // 4))

    bench.drive = drive
    return bench.moved()


@fault(
    DriverBench,
    "joint states without stamps (0), when a movement is asked for",
    "a repeated stamp is no step: the goal is aborted after start_timeout, which names them; the controller is silent",
    quick=False,
)
def without_stamps(bench: DriverBench) -> str:
    def drive(state: JointState) -> None:
        state.header.stamp = conversions.time_from_ns(0)
        bench.publish(state)

    bench.drive = drive
    began = bench.now_ns()
    words = "their stamps stand still at 0.000 s"
    bench.wait(lambda: any(words in item.reason for item in bench.modes.messages), "the controller to say so")
    result = bench.result(bench.move())
    took = 1e-9 * (bench.now_ns() - began)
    assert not result.success and words in result.reason, result.reason
    assert bench.modes.last is None or bench.modes.last.state == ControllerMode.WAITING
    return f"aborted: '{result.reason}' after {took:.1f} s; controller silent, {bench.assert_sound()}"


@fault(
    DriverBench,
    "joint states at 50 Hz, with settings for 500",
    "followed or not, it is said: a warning with what to set, and so does the goal where it fails",
    quick=False,
)
def slow(bench: DriverBench) -> str:
    count = 0

    def drive(state: JointState) -> None:
        nonlocal count
        count += 1
        if count % round(RATE / 50.0) == 0:
            bench.publish(state)

    bench.drive = drive
    log = bench.processes["impedance_controller"]
    words = "joint_state_timeout is 0.02 s, but joint states come every 0.02 s (measured): set it to 0.06 s or more"
    bench.wait(lambda: words in log.output, "the warning")
    result = bench.result(bench.move())
    if not result.success:
        assert "joint states come every 0.02 s (measured)" in result.reason, result.reason
    bench.wait(bench.said("impedance_controller", words), "the diagnostics")
    return f"'{words}' in the log and the diagnostics; the goal: '{result.reason}', {bench.assert_sound()}"


@fault(
    DriverBench,
    "one joint stops coming during a movement, the others go on",
    "the controller damps, is silent, and names the joint; the robot brakes, and the goal does not succeed",
    quick=False,
)
def one_joint_stops(bench: DriverBench) -> str:
    goal = bench.move(until=0.3)
    since = bench.now_ns()
    names = [name for name in OTHERS + LEFT if name != "left_e1"]
    bench.drive = lambda state: bench.publish(part(state, names, conversions.time_to_ns(state.header.stamp)))
    damping = bench.mode_since(ControllerMode.DAMPING, since)
    silent = bench.mode_since(ControllerMode.WAITING, since)
    assert "missing left_e1" in bench.modes.last.reason, bench.modes.last.reason
    result = bench.result(goal)
    assert not result.success, result.reason
    return (
        f"DAMPING after {damping:.2f} s, silent after {silent:.2f} s ('{bench.modes.last.reason}'); '{result.reason}'"
    )
