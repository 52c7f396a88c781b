# SPDX-License-Identifier: Apache-2.0
"""Joint states as drivers publish them: beside those of others, in parts, out of order, with stamps of no use."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import JointState

from faults.controller_bench import AWAY, STATE_TIMEOUT, ControllerBench
from faults.parts import gripper, part
from faults.table import fault
from ros_testing import spin_until
from simulated_hand import NAMES, TICK_NS, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros.messages import conversions

LEFT = [name for name in NAMES if name.startswith("left")]
OTHERS = [name for name in NAMES if not name.startswith("left")]
TICKS = 600


def measured(bench: ControllerBench, goal: np.ndarray, largest: float = 0.03) -> str:
    """It has followed, all the time; numbers."""
    assert set(bench.modes()) <= {ControllerState.ACTIVE}, bench.modes()
    bench.assert_sound()
    step = np.abs(np.diff(bench.efforts()[-TICKS // 2 :], axis=0)).max()
    speed = float(np.abs(bench.hand.simulator.state.v).max())
    error = np.linalg.norm(bench.hand.pose[:3] - goal[:3])
    assert step < largest and error < 0.02, (step, error)
    return f"ACTIVE, {1e3 * error:.1f} mm off, {speed:.3f} rad/s, largest torque step {100 * step:.1f} % of a limit"


def enter_gripper(rate: int) -> None:
    @fault(
        ControllerBench,
        f"a gripper's driver publishes on the same topic, {rate} times per second",
        "joints of others are ignored: followed as without them, no change of the mode",
        quick=rate == 50,
    )
    def beside_a_gripper(bench: ControllerBench) -> str:
        goal = bench.follow(300)
        for tick in range(TICKS):
            if tick % (1000 // rate) == 0:
                bench.hand.states.publish(gripper(bench.hand.stamp_ns + TICK_NS // 2))
            bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
        return measured(bench, goal)


for _rate in (50, 1000):
    enter_gripper(_rate)


@fault(
    ControllerBench,
    "joint states in two messages, 0.3 ms apart, from two drivers, and those of a gripper between them",
    "a state is complete when both have come, and as old as the older one: followed, no change of the mode",
)
def in_two_messages(bench: ControllerBench) -> str:
    goal = bench.follow(300)
    hand, before = bench.hand, len(bench.torques.messages)
    for _ in range(TICKS):
        hand.stamp_ns += TICK_NS
        state, older_ns = hand.state(), hand.stamp_ns - 3 * TICK_NS // 10
        due = 0.0

        def answered(state: JointState = state, older_ns: int = older_ns) -> bool:
            nonlocal due
            if time.monotonic() >= due:  # best effort may lose a message
                due = time.monotonic() + 0.2
                hand.references.publish(pose_reference(goal, older_ns))
                hand.states.publish(part(state, OTHERS, older_ns))
                hand.states.publish(gripper(older_ns + 1))
                hand.states.publish(part(state, LEFT, hand.stamp_ns))
            return older_ns in hand._answers

        spin_until(hand.node, answered, message="torques", processes=(hand.process,))
        hand.simulator.step(hand._answers[older_ns])
    stamps = [conversions.time_to_ns(message.header.stamp) for message in bench.torques.messages[before:]]
    newer = np.count_nonzero(np.array(stamps) % TICK_NS == 0)
    assert newer < 0.05 * len(stamps), f"{newer} of {len(stamps)} torques have the stamp of the newer part"
    return measured(bench, goal)


def stops(bench: ControllerBench, bad: Callable[[], None], reason: str) -> str:
    """It damps, names the reason, and is silent in the end."""
    torque = bench.efforts()[-1]
    said = bench.wait_for(ControllerState.DAMPING, reason, bad)
    change = float(np.abs(bench.efforts()[-1] - torque).max())
    silent = bench.wait_for(ControllerState.WAITING, reason, bad)
    bench.assert_sound()
    return f"{said}; torques changed by {100 * change:.1f} % of a limit; {silent[:40]}, {bench.assert_carried()}"


@fault(
    ControllerBench,
    "one joint stops coming, the others go on",
    "no state is complete: DAMPING after joint_state_timeout, then silence, and the joint is named",
)
def one_joint_stops(bench: ControllerBench) -> str:
    bench.follow()
    names = [name for name in NAMES if name != "left_e1"]

    def bad() -> None:
        bench.hand.stamp_ns += TICK_NS
        bench.hand.states.publish(part(bench.hand.state(), names, bench.hand.stamp_ns))

    return stops(bench, bad, "missing left_e1")


@fault(
    ControllerBench,
    "the arm's driver stops, a gripper's goes on",
    "DAMPING after joint_state_timeout, then silence, and what comes is named",
)
def only_others(bench: ControllerBench) -> str:
    bench.follow()

    def bad() -> None:
        bench.hand.stamp_ns += TICK_NS
        bench.hand.states.publish(gripper(bench.hand.stamp_ns))

    return stops(bench, bad, "none of its joints arrived; the last message names finger_joint1, finger_joint2")


@fault(
    ControllerBench,
    "the stamps of joint states do not change",
    "a repeated stamp is no state: DAMPING after joint_state_timeout, then silence, and the stamps are named",
)
def stamps_stand_still(bench: ControllerBench) -> str:
    bench.follow()

    def bad() -> None:
        bench.hand.states.publish(bench.hand.state())

    return stops(bench, bad, f"their stamps stay at {bench.hand.stamp_ns / 1e9:.3f} s")


@fault(
    ControllerBench,
    "one joint state in a hundred comes up to 10 ms late, after newer ones",
    "overtaken ones are ignored: followed as without them, no change of the mode",
)
def overtaken(bench: ControllerBench) -> str:
    goal = bench.follow(300)
    rng = np.random.default_rng(0)
    late: list[tuple[int, JointState]] = []
    for tick in range(TICKS):
        state = bench.hand.state()
        state.header.stamp = conversions.time_from_ns(bench.hand.stamp_ns)
        if rng.random() < 0.01:
            late.append((tick + int(rng.integers(1, 11)), state))
        for due, message in late:
            if due == tick:
                bench.hand.states.publish(message)
        bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
    assert late
    return f"{len(late)} of {TICKS} overtaken, {measured(bench, goal)}"


@fault(
    ControllerBench,
    "joint states with positions alone",
    "FAULT: velocities are needed, and the reason says so",
)
def without_velocities(bench: ControllerBench) -> str:
    bench.follow(150)
    goal = bench.hand.pose + AWAY

    def bad() -> None:
        state = bench.hand.state()
        state.velocity = array("d")
        bench.hand.references.publish(pose_reference(goal, bench.hand.stamp_ns))
        bench.hand.offer(state)

    said = bench.wait_for(ControllerState.FAULT, "velocity is empty", bad)
    bench.spin_for(STATE_TIMEOUT / 2, bad)
    return f"{said}, {bench.assert_carried()}"
