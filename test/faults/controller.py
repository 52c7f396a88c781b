# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller does about stale and bad joint states."""

from __future__ import annotations

from array import array
from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import JointState

from faults.controller_bench import SILENCE_AFTER, STATE_TIMEOUT, ControllerBench
from faults.table import fault
from ros_graph import SECOND
from simulated_hand import NAMES, TICK_NS, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros.messages import conversions

HOUR = 3600 * SECOND

# -- joint states -----------------------------------------------------------------------------------------------------


@fault(
    ControllerBench,
    "joint states stop",
    "DAMPING after joint_state_timeout: gravity compensation with damping; WAITING after silence_after more: nothing",
)
def joint_states_stop(bench: ControllerBench) -> str:
    bench.follow()
    last = len(bench.torques.messages)
    damping = bench.wait_for(ControllerState.DAMPING, f"no new joint state for {STATE_TIMEOUT:g} s")
    waiting = bench.wait_for(ControllerState.WAITING, "silent")
    count = len(bench.torques.messages) - last
    assert count > 0.5 * SILENCE_AFTER / 0.005
    carried = bench.assert_carried()
    bench.assert_silent()
    return f"{damping}, {count} safe torques, {waiting}, {carried}"


@fault(
    ControllerBench,
    "stamps of joint states do not change",
    "as when they stop: a repeated state proves nothing new",
)
def joint_states_frozen(bench: ControllerBench) -> str:
    bench.follow()
    frozen = bench.hand.state()

    def repeat() -> None:
        bench.hand.states.publish(frozen)

    damping = bench.wait_for(ControllerState.DAMPING, "no new joint state", repeat)
    waiting = bench.wait_for(ControllerState.WAITING, "silent", repeat)
    bench.assert_silent(meanwhile=repeat)
    return f"{damping}, {waiting}, {bench.assert_carried()}"


@fault(
    ControllerBench,
    "joint states an hour ahead of the clock",
    "FAULT with the reason: the safe torque where the robot was last, then nothing",
)
def joint_states_from_the_future(bench: ControllerBench) -> str:
    bench.follow()
    ahead = bench.hand.state()

    def early() -> None:
        ahead.header.stamp = conversions.time_from_ns(bench.node.get_clock().now().nanoseconds + HOUR)
        bench.hand.states.publish(ahead)

    said = bench.wait_for(ControllerState.FAULT, "ahead of this machine's clock", early)
    bench.spin_for(STATE_TIMEOUT + SILENCE_AFTER + 0.2, early)
    bench.assert_silent(meanwhile=early)
    assert set(bench.modes()) <= {ControllerState.ACTIVE, ControllerState.FAULT}
    return f"{said}, then silent, {bench.assert_carried()}"


@fault(
    ControllerBench,
    "stamps of joint states jump back by 10 s",
    "overtaken messages are not answered; after joint_state_timeout it is a new start, and the reference is forgotten",
)
def time_jumps_backwards(bench: ControllerBench) -> str:
    bench.follow()
    bench.hand.stamp_ns -= 10_000 * TICK_NS
    overtaken = bench.hand.state()
    answered = len(bench.torques.messages)
    bench.hand.states.publish(overtaken)
    said = bench.wait_for(ControllerState.DAMPING, "no new joint state")
    stamps = {conversions.time_to_ns(message.header.stamp) for message in bench.torques.messages[answered:]}
    assert bench.hand.stamp_ns not in stamps, "an overtaken state was answered"
    bench.hand.tick()
    return f"not answered, {said}, then {bench.wait_for(ControllerState.DAMPING, 'no reference yet')}"


@fault(
    ControllerBench,
    "joint states pause for 0.2 s",
    "for all that has a rate the pause counts as max_time_step: the torques do not step",
)
def joint_states_pause(bench: ControllerBench) -> str:
    goal = bench.follow()
    before = bench.efforts()[-1]
    bench.hand.stamp_ns += 200 * TICK_NS
    bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
    step = np.abs(bench.efforts()[-1] - before).max()
    assert step <= 0.15 + 1e-9, f"a step of {step} of a limit"
    return f"step after the pause {100 * step:.1f} % of a limit (15 % in 5 ms allowed)"


def with_nan(state: JointState) -> None:
    state.position[3] = float("nan")


def with_infinity(state: JointState) -> None:
    state.velocity[0] = float("inf")


def too_short(state: JointState) -> None:
    state.velocity = state.velocity[:-2]


def chosen(state: JointState, joints: list[int]) -> None:
    """Keep these joints only, in this order."""
    state.name = [NAMES[i] for i in joints]
    for name in ("position", "velocity", "effort"):
        setattr(state, name, array("d", [getattr(state, name)[i] for i in joints]))


def with_a_joint_twice(state: JointState) -> None:
    state.name = [NAMES[0], *NAMES[:-1]]


def implausibly_large(state: JointState) -> None:
    state.velocity = array("d", [1e200] * len(NAMES))


BAD_STATES: dict[str, tuple[Callable[[JointState], None], str]] = {
    "with NaN": (with_nan, "not finite"),
    "with infinite speeds": (with_infinity, "not finite"),
    "of wrong length": (too_short, "numbers for"),
    "with a joint named twice": (with_a_joint_twice, "twice"),
    "with speeds of 1e200 rad/s": (implausibly_large, "implausibly large"),
}


def enter_bad_states(name: str, spoil: Callable[[JointState], None], reason: str) -> None:
    @fault(
        ControllerBench,
        f"joint states {name}",
        "FAULT with the reason: the safe torque where the robot was last, no torque that is not finite",
    )
    def bad_states(bench: ControllerBench) -> str:
        bench.follow(150)
        torque = bench.efforts()[-1]

        def bad() -> None:
            state = bench.hand.state()
            spoil(state)
            bench.hand.offer(state)

        said = bench.wait_for(ControllerState.FAULT, reason, bad)
        bench.assert_sound()
        change = np.abs(bench.efforts()[-1] - torque).max()
        assert change < 0.1, f"torques changed by {change} of a limit"
        return f"{said[:160]}, torques changed by {100 * change:.1f} % of a limit"


for _name, (_spoil, _reason) in BAD_STATES.items():
    enter_bad_states(_name, _spoil, _reason)


@fault(
    ControllerBench,
    "only joint states with NaN, for a second",
    "FAULT, and silence after joint_state_timeout + silence_after",
)
def bad_joint_states_go_on(bench: ControllerBench) -> str:
    bench.follow(50)

    def bad() -> None:
        state = bench.hand.state()
        with_nan(state)
        bench.hand.offer(state)

    bench.spin_for(STATE_TIMEOUT + SILENCE_AFTER + 0.2, bad)
    bench.assert_silent(meanwhile=bad)
    assert bench.states.last.state == ControllerState.FAULT
    return f"FAULT and silent, {bench.assert_carried()}"


@fault(
    ControllerBench,
    "joint states in another order, with joints of others among them",
    "joints are matched by name: followed as before",
)
def joint_states_in_another_order(bench: ControllerBench) -> str:
    goal = bench.follow()
    order = np.random.default_rng(0).permutation(len(NAMES)).tolist()
    for _ in range(200):
        state = bench.hand.state()
        chosen(state, order)
        state.name = ["gripper_of_another", *state.name]
        for name in ("position", "velocity", "effort"):
            setattr(state, name, array("d", [0.5, *getattr(state, name)]))
        bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS), state)
    assert set(bench.modes()) <= {ControllerState.ACTIVE}
    bench.assert_sound()
    step = np.abs(np.diff(bench.efforts()[-200:], axis=0)).max()
    error = np.linalg.norm(bench.hand.pose[:3] - goal[:3])
    assert step < 0.03 and error < 0.02
    return f"ACTIVE, {1e3 * error:.1f} mm from the reference, largest torque step {100 * step:.1f} % of a limit"
