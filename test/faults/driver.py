# SPDX-License-Identifier: Apache-2.0
"""A robot's driver as drivers are, during movements of the whole graph: late, out of order, in parts, beside others."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import ClassVar

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from faults.graph_bench import GraphBench
from faults.parts import gripper
from faults.relay import MANNER_TOPIC
from faults.table import fault
from ros_graph import ACTIVATE, DEACTIVATE, SECOND, change_state, ros_arguments, set_parameters
from ros_testing import RunningProcess, StartProcess
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_ros.messages.qos import LATCHED, STREAM

CONTROLLER = "impedance_controller"
#: A machine that is busy with other things makes no false alarm, s.
PATIENT = {"joint_state_timeout": 0.25, "max_time_step": 0.02}


class DriverBench(GraphBench):
    """The graph, with a driver between the simulated robot's joint states and those who hear them."""

    name: ClassVar[str] = "driver"
    more: ClassVar[dict[str, dict[str, object]]] = {CONTROLLER: {**PATIENT}}

    def __init__(self, node: Node, start: StartProcess, directory: Path) -> None:
        path = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
        self.driver = start(sys.executable, "-m", "faults.relay", env={"PYTHONPATH": os.pathsep.join(path)})
        self._manner = node.create_publisher(String, MANNER_TOPIC, LATCHED)
        self._others = node.create_publisher(JointState, "joint_states", STREAM)
        super().__init__(node, start, directory)

    def spare(self, name: str) -> RunningProcess:
        remapped = ["-r", "joint_states:=driver/joint_states"] if name == "baxter_simulator" else []
        return self._start(name, *ros_arguments(**self.parameters[name]), *remapped)

    def drive(self, manner: str) -> None:
        """From now on in this manner, see `faults.relay`."""
        told = self.driver.output.count("manner:")
        self._manner.publish(String(data=manner))
        self.wait(lambda: self.driver.output.count("manner:") > told, "the driver to be told")

    def settle(self) -> str:
        self.drive("faithfully")
        return super().settle()

    def alive(self) -> None:
        super().alive()
        assert self.driver.returncode is None, self.driver.output[-2000:]

    def moved(self) -> str:
        """A movement that ends well although; numbers."""
        goal = self.move()
        self.modes.clear()
        result = self.result(goal)
        assert result.success, result.reason
        speed = max(float(np.abs(message.velocity).max(initial=0.0)) for message in self.states.messages)
        others = sum(item.state not in (ControllerMode.ACTIVE, ControllerMode.HOLD) for item in self.modes.messages)
        return f"{result.reason}; at most {speed:.2f} rad/s; damped or faulty {others} times; {self.assert_sound()}"


def enter_manner(name: str, manner: str, promise: str) -> None:
    @fault(DriverBench, f"{name}, during a movement", promise, quick=False)
    def driven(bench: DriverBench) -> str:
        bench.drive(manner)
        return bench.moved()


enter_manner(
    "one joint state in a hundred up to 10 ms late, after newer ones",
    "out_of_order",
    "overtaken ones are ignored by all: the movement ends well",
)
enter_manner(
    "joint states in two messages from two drivers",
    "in_parts",
    "complete states are answered: the movement ends well",
)


def enter_leaps(name: str, manner: str) -> None:
    @fault(
        DriverBench,
        f"{name}, during a movement",
        "such states are left out, and the diagnostics name a joint: the movement ends well",
        quick=False,
    )
    def left_out(bench: DriverBench) -> str:
        bench.drive(manner)
        observed = bench.moved()
        bench.wait(bench.said(CONTROLLER, "joint states were left out: "), "the diagnostics")
        return observed


enter_leaps("one joint state in fifty with an encoder that leaps by 0.5 rad", "leaping")
enter_leaps("a second robot of the same joints on the topic", "beside_another_robot")


def enter_velocities(name: str, manner: str) -> None:
    @fault(
        DriverBench,
        f"velocities of joint states {name}, during a movement",
        "FAULT once a joint has moved by some 0.1 rad, then silence; the goal is aborted, and names the joint",
        quick=False,
    )
    def contradicted(bench: DriverBench) -> str:
        bench.drive(manner)
        since = bench.now_ns()
        goal = bench.move()
        begun = np.array(bench.states.last.position)
        faulty = bench.mode_since(ControllerMode.FAULT, since)
        moved = float(np.abs(np.array(bench.states.last.position) - begun).max())
        assert "velocities contradict positions" in bench.modes.last.reason, bench.modes.last.reason
        result = bench.result(goal)
        assert not result.success and "velocities contradict positions" in result.reason, result.reason
        observed = f"FAULT after {faulty:.2f} s, {moved:.2f} rad moved; {bench.assert_sound()}: '{result.reason}'"
        bench.drive("faithfully")
        assert change_state(bench.node, CONTROLLER, DEACTIVATE, ACTIVATE)
        bench.clear()
        return observed


enter_velocities("always zero", "without_velocities")
enter_velocities("in degrees per second", "in_degrees")


@fault(
    DriverBench,
    "a gripper's driver publishes on the same topic at 50 Hz, its clock 20 ms ahead, during a movement",
    "no state, no tick, no fault of anybody: the movement ends well",
    quick=False,
)
def beside_a_gripper(bench: DriverBench) -> str:
    timer = bench.node.create_timer(0.02, lambda: bench._others.publish(gripper(bench.now_ns() + SECOND // 50)))
    try:
        return bench.moved()
    finally:
        bench.node.destroy_timer(timer)


@fault(
    DriverBench,
    "joint states without stamps (0), when a movement is asked for",
    "a repeated stamp is no step: the goal is aborted after start_timeout, which names them; the controller is silent",
    quick=False,
)
def without_stamps(bench: DriverBench) -> str:
    bench.drive("without_stamps")
    refused, words = "its stamp is 0: let the driver stamp", "their stamps stay at 0.000 s"
    bench.wait(lambda: any(refused in item.reason for item in bench.modes.messages), "the controller to say so")
    asked_ns = bench.now_ns()
    result = bench.result(bench.move())
    took = 1e-9 * (bench.now_ns() - asked_ns)
    assert not result.success and words in result.reason, result.reason
    return f"aborted after {took:.1f} s: '{result.reason}'; controller silent, {bench.assert_sound()}"


@fault(
    DriverBench,
    "joint states at 50 Hz, with settings for 500",
    "followed or not, it is said: a warning with what to set, and the goal says so too where it fails",
    quick=False,
)
def slow(bench: DriverBench) -> str:
    assert set_parameters(bench.node, CONTROLLER, joint_state_timeout=0.02, max_time_step=0.005).successful
    bench.drive("at_50_hz")
    words = "joint_state_timeout is 0.02 s, but joint states come every 0.02 s (measured): set it to 0.0"
    bench.wait(bench.said(CONTROLLER, words), "the diagnostics")
    assert words in bench.processes[CONTROLLER].output
    result = bench.result(bench.move())
    if not result.success:
        assert "joint states come every 0.02 s (measured)" in result.reason, result.reason
    observed = f"'{words}' in the log and the diagnostics; the goal: '{result.reason}', {bench.assert_sound()}"
    assert set_parameters(bench.node, CONTROLLER, **PATIENT).successful
    bench.wait(lambda: not bench.said(CONTROLLER, words)(), "the diagnostics to be well")
    return f"{observed}; with settings for it: {bench.moved()}"


@fault(
    DriverBench,
    "one joint stops coming during a movement, the others go on",
    "the controller damps, is silent, and names the joint; the goal does not succeed",
    quick=False,
)
def one_joint_stops(bench: DriverBench) -> str:
    goal = bench.move(until=0.3)
    since = bench.now_ns()
    bench.drive("without_an_elbow")
    damping = bench.mode_since(ControllerMode.DAMPING, since)
    silent = bench.mode_since(ControllerMode.WAITING, since)
    reason = bench.modes.last.reason
    assert "missing left_e1" in reason, reason
    result = bench.result(goal)
    assert not result.success and "missing left_e1" in result.reason, result.reason
    return f"DAMPING after {damping:.2f} s, silent after {silent:.2f} s; '{result.reason}'"
