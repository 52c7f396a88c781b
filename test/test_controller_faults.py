# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller does about stale and bad inputs, and how it ends: the rows of docs/interfaces.md.

Each fault is a function that takes a `FaultBench` and asserts its promise: the real node, the simulated robot, and
time that really passes. All wait with deadlines.
"""

from __future__ import annotations

import signal
from array import array
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState

from fault_bench import AWAY, RATE, FaultBench, bench_of
from ros_graph import ACTIVATE, CONFIGURE, DEACTIVATE, ROBOT_FILE, change_state, ros_arguments
from ros_testing import StartProcess, spin_until
from simulated_hand import NAMES, TICK_NS, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros import conversions

NODE = "impedance_controller"
#: Longer than the default, so that a machine that is busy with other things makes no false alarm in a test, s.
STATE_TIMEOUT, SILENCE_AFTER = 0.25, 0.4


@pytest.fixture(scope="module")
def module_bench(module_node: Node, start_module_process: StartProcess) -> FaultBench:
    process = start_module_process(
        NODE,
        *ros_arguments(
            robot_file=ROBOT_FILE, hold_time=0.3, joint_state_timeout=STATE_TIMEOUT, silence_after=SILENCE_AFTER
        ),
    )
    assert change_state(module_node, NODE, CONFIGURE)
    return bench_of(module_node, process)


@pytest.fixture
def bench(module_bench: FaultBench) -> Iterator[FaultBench]:
    """An active controller, which has forgotten what was before; the robot is at home, at rest."""
    module_bench.hand.simulator.reset()
    module_bench.hand.stamp_ns += 20_000 * TICK_NS
    assert change_state(module_bench.node, NODE, ACTIVATE)
    module_bench.states.clear()
    module_bench.torques.clear()
    yield module_bench
    assert change_state(module_bench.node, NODE, DEACTIVATE)


# -- joint states -----------------------------------------------------------------------------------------------------


def test_joint_states_stop(bench: FaultBench) -> None:
    bench.follow()
    bench.states.clear()
    last = len(bench.torques.messages)
    bench.wait_for(ControllerState.DAMPING, f"no new joint state for {STATE_TIMEOUT:g} s")
    bench.wait_for(ControllerState.WAITING, "silent")
    damping = bench.efforts()[last:]
    assert len(damping) > 0.5 * SILENCE_AFTER / 0.005
    np.testing.assert_allclose(damping[-1], bench.weight(), atol=0.01)
    bench.assert_silent(0.2)
    bench.assert_comes_back_without_a_jump()


def test_stamps_of_joint_states_stand_still(bench: FaultBench) -> None:
    bench.follow()
    bench.states.clear()
    frozen = bench.hand.state()

    def repeat() -> None:
        bench.hand.states.publish(frozen)

    bench.wait_for(ControllerState.DAMPING, "no new joint state", repeat)
    bench.wait_for(ControllerState.WAITING, "silent", repeat)
    bench.assert_silent(0.2, repeat)
    np.testing.assert_allclose(bench.efforts()[-1], bench.weight(), atol=0.01)
    bench.assert_comes_back_without_a_jump()


def test_stamps_of_joint_states_lie_in_the_future(bench: FaultBench) -> None:
    bench.follow()
    bench.states.clear()
    ahead = bench.hand.state()

    def early() -> None:
        ahead.header.stamp = conversions.time_from_ns(bench.node.get_clock().now().nanoseconds + 3600 * 10**9)
        bench.hand.states.publish(ahead)

    bench.wait_for(ControllerState.FAULT, "ahead of this machine's clock", early)
    bench.spin_for(STATE_TIMEOUT + SILENCE_AFTER + 0.2, early)
    bench.assert_silent(0.2, early)
    assert bench.modes() == [ControllerState.ACTIVE, ControllerState.FAULT] or bench.modes() == [ControllerState.FAULT]
    np.testing.assert_allclose(bench.efforts()[-1], bench.weight(), atol=0.01)
    bench.assert_comes_back_without_a_jump()


def test_time_jumps_backwards(bench: FaultBench) -> None:
    bench.follow()
    bench.states.clear()
    bench.hand.stamp_ns -= 10_000 * TICK_NS
    overtaken = bench.hand.state()
    answered = len(bench.torques.messages)
    bench.hand.states.publish(overtaken)
    bench.wait_for(ControllerState.DAMPING, "no new joint state")
    # by then what is older is no message that was overtaken any more
    stamps = {conversions.time_to_ns(message.header.stamp) for message in bench.torques.messages[answered:]}
    assert bench.hand.stamp_ns not in stamps
    bench.hand.tick()
    bench.wait_for(ControllerState.DAMPING, "no reference yet")
    bench.assert_comes_back_without_a_jump()


def with_nan(state: JointState) -> None:
    state.position[3] = float("nan")


def with_infinity(state: JointState) -> None:
    state.velocity[0] = float("inf")


def too_short(state: JointState) -> None:
    state.velocity = state.velocity[:-2]


def without_a_joint(state: JointState) -> None:
    chosen = [i for i, name in enumerate(NAMES) if name != "left_s0"]
    state.name = [NAMES[i] for i in chosen]
    for name in ("position", "velocity", "effort"):
        setattr(state, name, array("d", [getattr(state, name)[i] for i in chosen]))


def with_a_joint_twice(state: JointState) -> None:
    state.name = [NAMES[0], *NAMES[:-1]]


def out_of_all_proportion(state: JointState) -> None:
    state.velocity = array("d", [1e200] * len(NAMES))


BAD_STATES: dict[Callable[[JointState], None], str] = {
    with_nan: "not finite",
    with_infinity: "not finite",
    too_short: "numbers for",
    without_a_joint: "joints missing: left_s0",
    with_a_joint_twice: "twice",
    out_of_all_proportion: "out of all proportion",
}


@pytest.mark.parametrize("spoil", BAD_STATES, ids=lambda spoil: spoil.__name__)
def test_joint_states_that_cannot_be_used(bench: FaultBench, spoil: Callable[[JointState], None]) -> None:
    bench.follow(50)
    bench.states.clear()
    torque = bench.efforts()[-1]

    def bad() -> None:
        state = bench.hand.state()
        spoil(state)
        bench.hand.offer(state)

    bench.wait_for(ControllerState.FAULT, BAD_STATES[spoil], bad)
    bench.assert_sound()
    assert np.abs(bench.efforts()[-1] - torque).max() < 0.1
    bench.assert_comes_back_without_a_jump()


def test_bad_joint_states_that_go_on_end_in_silence(bench: FaultBench) -> None:
    bench.follow(50)

    def bad() -> None:
        state = bench.hand.state()
        with_nan(state)
        bench.hand.offer(state)

    bench.spin_for(STATE_TIMEOUT + SILENCE_AFTER + 0.2, bad)
    bench.assert_silent(0.2, bad)
    assert bench.states.last.state == ControllerState.FAULT
    np.testing.assert_allclose(bench.efforts()[-1], bench.weight(), atol=0.01)
    bench.assert_comes_back_without_a_jump()


# -- references -------------------------------------------------------------------------------------------------------


def test_references_stop(bench: FaultBench) -> None:
    goal = bench.follow(900)
    bench.states.clear()
    bench.wait_for(ControllerState.HOLD, "no reference for 0.1 s", bench.hand.tick)
    np.testing.assert_allclose(bench.hand.pose[:3], goal[:3], atol=0.01)
    bench.wait_for(ControllerState.DAMPING, "no reference for 0.4 s", bench.hand.tick)
    bench.assert_comes_back_without_a_jump()


def test_stamps_of_references_stand_still(bench: FaultBench) -> None:
    goal = bench.follow(100)
    bench.states.clear()
    stamp = bench.hand.stamp_ns
    bench.wait_for(ControllerState.HOLD, "", lambda: bench.hand.tick(pose_reference(goal, stamp)))
    bench.wait_for(ControllerState.DAMPING, "", lambda: bench.hand.tick(pose_reference(goal, stamp)))
    bench.assert_comes_back_without_a_jump()


def test_references_that_were_long_on_their_way(bench: FaultBench) -> None:
    for _ in range(300):  # each stamp is new, and half a second old
        bench.hand.tick(pose_reference(bench.hand.pose + AWAY, bench.hand.stamp_ns - 500 * TICK_NS))
    assert set(bench.modes()) <= {ControllerState.WAITING, ControllerState.DAMPING}
    bench.assert_comes_back_without_a_jump()


def test_stamps_of_references_lie_in_the_future(bench: FaultBench) -> None:
    bench.follow(50)
    bench.states.clear()
    ahead = bench.node.get_clock().now().nanoseconds + 3600 * 10**9

    def early() -> None:
        bench.hand.tick(pose_reference(bench.hand.pose, ahead))

    bench.wait_for(ControllerState.HOLD, "ahead of this machine's clock", early)
    bench.wait_for(ControllerState.DAMPING, "ahead of this machine's clock", early)
    bench.assert_comes_back_without_a_jump()


# -- the end ----------------------------------------------------------------------------------------------------------


def assert_let_go(bench: FaultBench, pushed: np.ndarray) -> None:
    """The last torque carries the robot, and the way there kept the rate limit."""
    bench.spin_for(0.1)  # what is still on its way
    efforts = bench.efforts()
    assert np.abs(pushed - bench.weight()).max() > 0.05  # there was something to let go of
    np.testing.assert_allclose(efforts[-1], bench.weight(), atol=0.02)
    assert np.abs(np.diff(efforts[-30:], axis=0)).max() <= RATE + 1e-9
    bench.assert_silent(0.2)


def push(bench: FaultBench) -> np.ndarray:
    """Have the controller pull at a hand that is stuck; the torques (nv,) in shares of their limits."""
    stuck = bench.hand.simulator.state.q
    for tick in range(400):
        goal = bench.hand.pose + min(1.0, tick / 300) * AWAY
        bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
        bench.hand.simulator.reset(stuck)
    return bench.efforts()[-1]


def test_deactivation_leaves_the_robot_with_what_carries_it(bench: FaultBench) -> None:
    pushed = push(bench)
    assert change_state(bench.node, NODE, DEACTIVATE)
    assert_let_go(bench, pushed)
    assert change_state(bench.node, NODE, ACTIVATE)  # as the fixture expects it


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_signal_leaves_the_robot_with_what_carries_it(
    ros_node: Node, start_process: StartProcess, number: signal.Signals
) -> None:
    process = start_process(NODE, *ros_arguments(robot_file=ROBOT_FILE, joint_state_timeout=5.0))
    assert change_state(ros_node, NODE, CONFIGURE, ACTIVATE)
    bench = bench_of(ros_node, process)
    pushed = push(bench)
    process.send_signal(number)
    spin_until(ros_node, lambda: process.returncode is not None, message="the process to end")
    assert process.returncode == 0
    assert_let_go(bench, pushed)


def test_the_default_timeouts_answer_silence_within_a_twentieth_of_a_second(
    ros_node: Node, start_process: StartProcess
) -> None:
    process = start_process(NODE, *ros_arguments(robot_file=ROBOT_FILE))
    assert change_state(ros_node, NODE, CONFIGURE, ACTIVATE)
    bench = bench_of(ros_node, process)
    bench.hand.tick()
    bench.wait_for(ControllerState.DAMPING, "no new joint state for 0.02 s")
    bench.wait_for(ControllerState.WAITING, "no new joint state for 0.22 s: silent")
    bench.assert_silent(0.1)
