# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller does about stale and bad joint states and references."""

from __future__ import annotations

from array import array
from collections.abc import Callable

import numpy as np
from sensor_msgs.msg import JointState

from faults.controller_bench import AWAY, NODE, SILENCE_AFTER, STATE_TIMEOUT, ControllerBench
from faults.table import fault
from ros_graph import SECOND, set_parameters
from ros_testing import spin_until
from simulated_hand import NAMES, TICK_NS, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros import conversions

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
    "stamps of joint states stand still",
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


def without_a_joint(state: JointState) -> None:
    chosen(state, [i for i, name in enumerate(NAMES) if name != "left_s0"])


def with_a_joint_twice(state: JointState) -> None:
    state.name = [NAMES[0], *NAMES[:-1]]


def without_anything(state: JointState) -> None:
    chosen(state, [])


def out_of_all_proportion(state: JointState) -> None:
    state.velocity = array("d", [1e200] * len(NAMES))


BAD_STATES: dict[str, tuple[Callable[[JointState], None], str]] = {
    "with NaN": (with_nan, "not finite"),
    "with infinite speeds": (with_infinity, "not finite"),
    "of wrong length": (too_short, "numbers for"),
    "without one of the joints": (without_a_joint, "joints missing: left_s0"),
    "that are empty": (without_anything, "joints missing"),
    "with a joint named twice": (with_a_joint_twice, "twice"),
    "with speeds of 1e200 rad/s": (out_of_all_proportion, "out of all proportion"),
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


# -- references -------------------------------------------------------------------------------------------------------


@fault(
    ControllerBench,
    "references stop",
    "HOLD after reference_timeout, at the last pose with its stiffness; DAMPING after hold_time more",
)
def references_stop(bench: ControllerBench) -> str:
    goal = bench.follow(900)
    hold = bench.wait_for(ControllerState.HOLD, "no reference for 0.1 s", bench.hand.tick)
    error = np.linalg.norm(bench.hand.pose[:3] - goal[:3])
    assert error < 0.01
    damping = bench.wait_for(ControllerState.DAMPING, "no reference for 0.4 s", bench.hand.tick)
    return f"{hold}, held {1e3 * error:.1f} mm from the last one, {damping}"


@fault(ControllerBench, "stamps of references stand still", "as when they stop: HOLD, then DAMPING")
def references_frozen(bench: ControllerBench) -> str:
    goal = bench.follow(100)
    stamp = bench.hand.stamp_ns

    def repeat() -> None:
        bench.hand.tick(pose_reference(goal, stamp))

    hold = bench.wait_for(ControllerState.HOLD, "", repeat)
    return f"{hold}, {bench.wait_for(ControllerState.DAMPING, '', repeat)}"


@fault(
    ControllerBench,
    "references that were 0.5 s on their way",
    "never followed: the age by the stamp counts as much as that since the arrival",
)
def references_late(bench: ControllerBench) -> str:
    start = bench.hand.pose
    for _ in range(300):
        bench.hand.tick(pose_reference(start + AWAY, bench.hand.stamp_ns - 500 * TICK_NS))
    assert set(bench.modes()) <= {ControllerState.WAITING, ControllerState.DAMPING}, bench.modes()
    moved = np.linalg.norm(bench.hand.pose[:3] - start[:3])
    assert moved < 0.005
    return f"DAMPING throughout, the hand moved by {1e3 * moved:.2f} mm"


@fault(
    ControllerBench,
    "references an hour ahead of the clock",
    "refused: HOLD, then DAMPING, which name the reason",
)
def references_from_the_future(bench: ControllerBench) -> str:
    bench.follow(50)
    ahead = bench.node.get_clock().now().nanoseconds + HOUR

    def early() -> None:
        bench.hand.tick(pose_reference(bench.hand.pose, ahead))

    hold = bench.wait_for(ControllerState.HOLD, "ahead of this machine's clock", early)
    bench.wait_for(ControllerState.DAMPING, "ahead of this machine's clock", early)
    return f"{hold}, then DAMPING"


def nan_mean(message: ReferenceMessage) -> None:
    message.gaussian.mean[1] = float("nan")


def infinite_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance[0] = float("inf")


def negative_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance[0] = -1.0


def short_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance = message.gaussian.covariance[:-1]


def planar(message: ReferenceMessage) -> None:
    message.gaussian.manifold = "euclidean"


def elsewhere(message: ReferenceMessage) -> None:
    message.header.frame_id = "camera"


BAD_REFERENCES: dict[str, tuple[Callable[[ReferenceMessage], None], str]] = {
    "with NaN": (nan_mean, "not finite"),
    "with an infinite covariance": (infinite_covariance, "not finite"),
    "with a covariance that is not positive definite": (negative_covariance, "positive definite"),
    "of wrong length": (short_covariance, "expected"),
    "on another manifold": (planar, "euclidean"),
    "in a wrong frame_id": (elsewhere, "'camera'"),
}


def enter_bad_references(name: str, spoil: Callable[[ReferenceMessage], None], reason: str) -> None:
    @fault(
        ControllerBench, f"references {name}", "refused: HOLD at the last good one, then DAMPING; both name the reason"
    )
    def bad_references(bench: ControllerBench) -> str:
        goal = bench.follow(400)

        def bad() -> None:
            message = pose_reference(goal + 10 * AWAY, bench.hand.stamp_ns + TICK_NS)
            spoil(message)
            bench.hand.tick(message)

        hold = bench.wait_for(ControllerState.HOLD, reason, bad)
        bench.wait_for(ControllerState.DAMPING, "the newest was refused", bad)
        error = np.linalg.norm(bench.hand.pose[:3] - goal[:3])
        assert error < 0.03
        return f"{hold[:200]}, then DAMPING"


for _name, (_bad, _reason) in BAD_REFERENCES.items():
    enter_bad_references(_name, _bad, _reason)


@fault(
    ControllerBench,
    "a reference that leaps by 0.1 m",
    "followed at max_linear_speed (0.4 m/s), torques within their limits and rates",
)
def reference_leaps(bench: ControllerBench) -> str:
    start = bench.follow()
    first = len(bench.torques.messages)
    goal = start + np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    heights = []
    for _ in range(600):
        bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
        heights.append(bench.hand.pose[2])
    speed = np.max(np.diff(heights)) / 1e-3
    step = np.abs(np.diff(bench.efforts()[first:], axis=0)).max()
    bench.assert_sound()
    assert speed < 0.6 and step <= 0.03 + 1e-9
    assert abs(heights[-1] - goal[2]) < 0.02
    return f"hand at most {speed:.2f} m/s, largest torque step {100 * step:.1f} % of a limit in 1 ms"


# -- parameters -------------------------------------------------------------------------------------------------------


@fault(
    ControllerBench,
    "parameters out of their range, or that contradict each other, while active",
    "refused as a whole with the reason; followed as before",
)
def bad_parameters(bench: ControllerBench) -> str:
    goal = bench.follow()
    reasons = []
    for values in ({"blend_time": -1.0}, {"torque_rate": 1e9}, {"min_stiffness": 3000.0}, {"robot_file": "other.yaml"}):
        result = set_parameters(bench.node, NODE, **values)
        assert not result.successful and next(iter(values)) in result.reason, result
        reasons.append(result.reason)
    # two values, of which one is good: none is taken
    assert not set_parameters(bench.node, NODE, hold_time=0.5, max_power=-1.0).successful
    bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
    spin_until(bench.node, lambda: bench.hand.answered())
    assert set(bench.modes()) <= {ControllerState.ACTIVE, ControllerState.HOLD, ControllerState.DAMPING}
    return f"refused {len(reasons) + 1} of {len(reasons) + 1}, e.g. '{reasons[2]}'"
