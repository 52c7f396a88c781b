# SPDX-License-Identifier: Apache-2.0
"""Nodes that are killed, suspended, started twice, or kept from their processor: the others wait for them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import numpy as np

from faults.graph_bench import GraphBench
from faults.table import fault
from ros_graph import ALL_LATCHED, Inbox
from simulated_hand import ROBOT
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_msgs.msg import ControllerState, TaskFrame, TaskParameters

#: A joint that is slower than this is at rest, rad/s.
AT_REST = 0.05
#: `command_timeout`, s, and `braking_rate`, 1/s, of the robot.
COMMAND_TIMEOUT, BRAKING_RATE = 0.1, 20.0


@fault(
    GraphBench,
    "SIGKILL of frame_tracker during a movement, and its restart",
    "the movement goes on with the last frames and ends well; the diagnostics of reproduction ask for frame_tracker",
    quick=False,
)
def tracker_killed(bench: GraphBench) -> str:
    goal = bench.move(until=0.3)
    bench.kill("frame_tracker")
    seconds = bench.wait(bench.said("reproduction", "check that frame_tracker is running"), "the diagnostics to ask")
    result = bench.result(goal)
    assert result.success, result.reason
    observed = bench.assert_sound()
    bench.start("frame_tracker")
    return f"asked for after {seconds:.1f} s, ended {1e3 * result.final_position_error:.1f} mm off, {observed}"


@fault(
    GraphBench,
    "SIGKILL of reproduction during a movement, and its restart",
    "the controller holds after reference_timeout, and damps after hold_time; a new goal moves again",
    quick=False,
)
def reproduction_killed(bench: GraphBench) -> str:
    bench.move(until=0.3)
    killed_ns = bench.now_ns()
    bench.kill("reproduction")
    hold = bench.mode_since(ControllerMode.HOLD, killed_ns)
    damping = bench.mode_since(ControllerMode.DAMPING, killed_ns)
    bench.wait(lambda: bench.speed() < AT_REST, "rest")
    observed = bench.assert_sound()
    bench.start("reproduction")
    return f"HOLD after {hold:.2f} s, DAMPING after {damping:.2f} s, {observed}"


@fault(
    GraphBench,
    "SIGKILL of impedance_controller while the robot moves, and its restart",
    "the robot brakes after command_timeout (0.1 s), at braking_rate (20 1/s); the new controller takes over",
    quick=False,
)
def controller_killed(bench: GraphBench) -> str:
    bench.move(until=0.3)
    bench.wait(lambda: bench.speed() > 10 * AT_REST, "the arm to move")
    speed = bench.speed()
    bench.states.clear()
    bench.kill("impedance_controller")
    rest = bench.wait(lambda: bench.states.last and bench.speed() < AT_REST, "rest")
    bench.wait(bench.said("baxter_simulator", "torques stopped"), "the diagnostics to tell")
    positions = np.array([message.position for message in bench.states.messages])
    way = float(np.ptp(positions, axis=0).max())
    fastest = float(np.abs([message.velocity for message in bench.states.messages]).max())
    # the last torque goes on until the timeout, and then the speed dies out; states come late, hence the double
    bound = 2.0 * fastest * (COMMAND_TIMEOUT + 1.0 / BRAKING_RATE)
    assert way < bound, f"at rest after {rest} s and {way} rad, more than {bound} rad after {fastest} rad/s"
    bench.clear()
    bench.start("impedance_controller")
    bench.wait(lambda: bench.torques.messages, "torques")
    first = np.array(bench.torques.messages[0].effort) / ROBOT.effort_limits
    data = ROBOT.create_data()
    weight = data.gravity(np.array(bench.states.last.position)).copy() / ROBOT.effort_limits
    apart = float(np.abs(first - weight).max())
    assert apart < 0.1, f"the first torque is {apart} of a limit from gravity compensation"
    return (
        f"moving at {speed:.2f} rad/s, at most at {fastest:.2f} rad/s, at rest after {rest:.2f} s and {way:.3f} rad; "
        f"first torque of the new one {100 * apart:.1f} % of a limit from gravity compensation"
    )


@fault(
    GraphBench,
    "SIGKILL of the simulated robot during a movement, and its restart",
    "the controller damps, then is silent; the goal is aborted and asks for the robot; a new robot moves again",
    quick=False,
)
def robot_killed(bench: GraphBench) -> str:
    goal = bench.move(until=0.3)
    killed_ns = bench.now_ns()
    bench.kill("baxter_simulator")
    silent = bench.mode_since(ControllerMode.WAITING, killed_ns)
    sent = len(bench.torques.messages)
    result = bench.result(goal)
    assert not result.success and "no joint states" in result.reason, result.reason
    assert len(bench.torques.messages) == sent, "torques without a robot"
    observed = bench.assert_sound()
    bench.start("baxter_simulator")
    return f"silent after {silent:.2f} s, aborted: '{result.reason}', {observed}"


def enter_pause(name: str, pause: float, promise: str) -> None:
    @fault(GraphBench, f"{name} suspended for {pause:g} s (SIGSTOP, SIGCONT) during a movement", promise, quick=False)
    def suspended(bench: GraphBench) -> str:
        goal = bench.move(duration=6.0, until=0.2)
        process = bench.processes[name]
        since_ns = bench.now_ns()
        process.send_signal(signal.SIGSTOP)
        try:
            bench.spin_for(pause)
        finally:
            process.send_signal(signal.SIGCONT)
        result = bench.result(goal)
        bench.alive()
        modes = [
            ControllerMode(item.state).name
            for item in bench.modes.messages
            if item.header.stamp.sec + 1e-9 * item.header.stamp.nanosec >= 1e-9 * since_ns
        ]
        changes = [mode for i, mode in enumerate(modes) if i == 0 or mode != modes[i - 1]]
        assert changes and changes[-1] == "ACTIVE", changes
        observed = bench.assert_sound()
        return f"controller {', '.join(changes)}; movement: {result.reason}; {observed}"


for _name, _promise in (
    ("frame_tracker", "the movement goes on and ends; torques within limits and rates"),
    ("reproduction", "HOLD meanwhile, then it is followed again without a step of the torques"),
    ("impedance_controller", "the robot brakes; then the controller goes on, without a step of its torques"),
    ("baxter_simulator", "DAMPING and silence meanwhile; then the robot is driven again, without a step"),
):
    enter_pause(_name, 0.7, _promise)


@fault(
    GraphBench,
    "impedance_controller started twice",
    "controllers and robot name the second in their diagnostics; torques finite and within limits; it may leave again",
    quick=False,
)
def controller_started_twice(bench: GraphBench) -> str:
    second = bench.spare("impedance_controller")
    words = "2 publishers on /joint_torques"
    bench.wait(bench.said("baxter_simulator", words), "the robot to complain")
    bench.wait(bench.said("impedance_controller", words), "the controllers to complain")
    goal = bench.move()
    result = bench.result(goal)
    efforts = np.array([message.effort for message in bench.torques.messages])
    share = float((np.abs(efforts) / ROBOT.effort_limits).max())
    assert np.isfinite(efforts).all() and share <= 1.0 + 1e-9
    second.send_signal(signal.SIGTERM)
    bench.wait(lambda: second.returncode is not None, "the second to end")
    assert second.returncode == 0
    seconds = bench.wait(lambda: not bench.said("baxter_simulator", words)(), "the complaint to end")
    return (
        f"'{words}', movement meanwhile: {result.reason}, torques at most {100 * share:.0f} % of their limits; "
        f"complaint gone {seconds:.1f} s after the second"
    )


@fault(
    GraphBench,
    "100 % load on all cores during a movement",
    "the nodes, which run at real-time priority, keep their ticks: no DAMPING, and the movement ends well",
    quick=False,
)
def load(bench: GraphBench) -> str:
    if "no real-time priority" in bench.processes["impedance_controller"].output:
        patience = "not permitted here: the controller may damp meanwhile"
    else:
        patience = ""
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        goal = bench.move(until=0.05)
        since = bench.now_ns()
        result = bench.result(goal)
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    stamps = np.array([1e9 * item.header.stamp.sec + item.header.stamp.nanosec for item in bench.states.messages])
    pause = 1e-6 * np.diff(stamps[stamps >= since]).max()
    lost = {ControllerMode(item.state).name for item in bench.modes.messages[1:]} - {"ACTIVE", "HOLD"}
    assert patience or (result.success and not lost), f"{result.reason}; {lost}"
    return f"longest pause of joint states {pause:.0f} ms, {result.reason}, {bench.assert_sound()} {patience}".strip()


@fault(
    GraphBench,
    "a node that starts late",
    "gets the last task parameters and the controller's state at once: both are latched",
    quick=False,  # its movement afterwards wants a machine with nothing else to do
)
def late_joiner(bench: GraphBench) -> str:
    bench.places = {}
    late = Inbox(bench.node, TaskParameters, "task_parameters", ALL_LATCHED)
    state = Inbox(bench.node, ControllerState, "controller_state", ALL_LATCHED)
    seconds = bench.wait(lambda: late.messages and state.messages, "what is latched")
    frames = {item.name: item.status for item in late.messages[0].frames}
    assert frames["robot"] == TaskFrame.VISIBLE and state.messages[0].reason
    return f"both within {seconds:.2f} s"
