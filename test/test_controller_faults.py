# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller does about stale and bad inputs, and how it ends: the rows of docs/interfaces.md.

Each fault is a function that takes a `FaultBench` and asserts its promise: the real node, the simulated robot, and
time that really passes.
"""

from __future__ import annotations

import itertools
import signal
import time
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ACTIVATE, ALL, ALL_LATCHED, CONFIGURE, DEACTIVATE, ROBOT_FILE, Inbox, change_state, ros_arguments
from ros_testing import RunningProcess, StartProcess, spin_until
from simulated_hand import NAMES, ROBOT, TICK_NS, SimulatedHand, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros import conversions

NODE = "impedance_controller"
#: Longer than the default, so that a machine that is busy with other things makes no false alarm in a test, s.
STATE_TIMEOUT, SILENCE_AFTER = 0.25, 0.4
#: Of the effort limits, per step; the rate limit is 0.03 per ms.
RATE = 0.03
AWAY = np.array([0.0, 0.03, 0.03, 0.0, 0.0, 0.0, 0.0])


@dataclass
class FaultBench:
    """A controller, the robot that it drives, and what it has said since it was activated."""

    node: Node
    process: RunningProcess
    hand: SimulatedHand
    states: Inbox
    torques: Inbox

    def follow(self, ticks: int = 300) -> np.ndarray:
        """Follow a reference a little way off; returns the pose (7,) that is asked for."""
        goal = self.hand.pose + AWAY
        for _ in range(ticks):
            self.hand.tick(pose_reference(goal, self.hand.stamp_ns + TICK_NS))
        return goal

    def modes(self) -> list[int]:
        """The modes one after the other, each change once."""
        return [mode for mode, _ in itertools.groupby(message.state for message in self.states.messages)]

    def wait_for(self, mode: int, reason: str = "", meanwhile: Callable[[], object] = lambda: None) -> ControllerState:
        """The message that says that it is in a mode for a reason; `meanwhile` is done all the time."""

        def reached() -> bool:
            meanwhile()
            return any(message.state == mode and reason in message.reason for message in self.states.messages)

        spin_until(self.node, reached, message=f"mode {mode}: {reason}", processes=(self.process,))
        return next(message for message in self.states.messages if message.state == mode and reason in message.reason)

    def efforts(self) -> np.ndarray:
        """All torques that were sent (T, nv), in shares of their limits."""
        return np.array([message.effort for message in self.torques.messages]).reshape(-1, ROBOT.nv) / (
            ROBOT.effort_limits
        )

    def weight(self) -> np.ndarray:
        """What carries the robot where it is, in shares of the limits (nv,)."""
        data = ROBOT.create_data()
        return data.gravity(self.hand.simulator.state.q).copy() / ROBOT.effort_limits

    def assert_sound(self) -> None:
        """No torque beyond its limit, and none that is not finite."""
        efforts = self.efforts()
        assert np.isfinite(efforts).all()
        assert (np.abs(efforts) <= 1.0).all()

    def assert_silent(self, seconds: float, meanwhile: Callable[[], object] = lambda: None) -> None:
        """No torque leaves for some time."""
        sent, end = len(self.torques.messages), time.monotonic() + seconds

        def over() -> bool:
            meanwhile()
            return time.monotonic() > end

        spin_until(self.node, over)
        assert len(self.torques.messages) == sent

    def assert_comes_back_without_a_jump(self) -> None:
        """Good inputs again: it follows again, and no torque moves faster than the rate limit meanwhile."""
        self.states.clear()
        before = len(self.torques.messages)
        goal = self.hand.pose
        # the first torque after a silence has had more time
        for tick in range(700):
            self.hand.tick(pose_reference(goal, self.hand.stamp_ns + TICK_NS))
            if tick == 0:
                before = len(self.torques.messages)
        assert self.states.last.state == ControllerState.ACTIVE
        steps = np.abs(np.diff(self.efforts()[before:], axis=0))
        assert len(steps) > 600 and steps.max() < RATE
        np.testing.assert_allclose(self.hand.pose[:3], goal[:3], atol=0.02)
        self.assert_sound()


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


def bench_of(node: Node, process: RunningProcess) -> FaultBench:
    """A bench for a controller that is configured."""
    hand = SimulatedHand(node, process)
    states = Inbox(node, ControllerState, "controller_state", ALL_LATCHED)
    torques = Inbox(node, JointState, "joint_torques", ALL)
    spin_until(
        node,
        lambda: hand.states.get_subscription_count() and hand.references.get_subscription_count(),
        message="the controller to listen",
        processes=(process,),
    )
    return FaultBench(node, process, hand, states, torques)


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
    end = time.monotonic() + STATE_TIMEOUT + SILENCE_AFTER + 0.2
    spin_until(bench.node, lambda: early() or time.monotonic() > end)
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


BAD_STATES = {
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

    end = time.monotonic() + STATE_TIMEOUT + SILENCE_AFTER + 0.2
    spin_until(bench.node, lambda: bad() or time.monotonic() > end)
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
    drained = time.monotonic() + 0.1
    spin_until(bench.node, lambda: time.monotonic() > drained)
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
