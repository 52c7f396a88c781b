# SPDX-License-Identifier: Apache-2.0
"""impedance_controller on its topics: references and joint states in, torques and states of the controller out."""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rclpy.node import Node

from ros_graph import (
    ACTIVATE,
    ALL_LATCHED,
    CONFIGURE,
    DEACTIVATE,
    ROBOT_FILE,
    Inbox,
    change_state,
    ros_arguments,
    set_parameters,
)
from ros_testing import RunningProcess, StartProcess, spin_until
from simulated_hand import NAMES, ROBOT, SimulatedHand, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage

NODE = "impedance_controller"
#: From one millisecond to the next no torque moves by more than this share of its limit when a reference comes or goes
GENTLE = 0.02


@pytest.fixture(scope="module")
def process(start_module_process: StartProcess) -> RunningProcess:
    # the hand's time is its own: its stamps are of another clock
    values = {"hold_time": 0.3, "joint_state_timeout": 5.0, "max_age": 0.0}
    return start_module_process(NODE, *ros_arguments(robot_file=ROBOT_FILE, **values))


@pytest.fixture(scope="module")
def configured(module_node: Node, process: RunningProcess) -> Inbox:
    """The states of a controller that is configured, and not yet active."""
    assert change_state(module_node, NODE, CONFIGURE)
    return Inbox(module_node, ControllerState, "controller_state", ALL_LATCHED)


@pytest.fixture(scope="module")
def hand(module_node: Node, configured: Inbox, process: RunningProcess) -> SimulatedHand:
    hand = SimulatedHand(module_node, process)
    spin_until(
        module_node,
        lambda: hand.states.get_subscription_count() and hand.references.get_subscription_count(),
        message="the controller to listen",
    )
    return hand


@pytest.fixture
def active(module_node: Node, hand: SimulatedHand, configured: Inbox) -> Iterator[Inbox]:
    """The states of an active controller, which has forgotten what was before; the robot is at home, at rest."""
    assert change_state(module_node, NODE, ACTIVATE)
    hand.simulator.reset()
    hand.torques.clear()
    configured.clear()
    yield configured
    assert change_state(module_node, NODE, DEACTIVATE)


def states_of(inbox: Inbox) -> list[int]:
    """The states one after the other, each change once."""
    return [state for state, _ in itertools.groupby(message.state for message in inbox.messages)]


def follow(hand: SimulatedHand, goal: np.ndarray, ticks: int) -> None:
    for _ in range(ticks):
        hand.tick(pose_reference(goal, hand.stamp_ns))


def wait_for_state(hand: SimulatedHand, inbox: Inbox, state: int) -> ControllerState:
    def reached() -> bool:
        hand.tick()
        return bool(inbox.messages) and inbox.last.state == state

    spin_until(hand.node, reached, message=f"state {state}")
    return inbox.last


def steps(hand: SimulatedHand) -> np.ndarray:
    """Changes of the torques from tick to tick in shares of their limits, (T - 1, nv)."""
    return np.abs(np.diff(hand.torques, axis=0)) / ROBOT.effort_limits


def assert_within_limits(hand: SimulatedHand) -> None:
    torques = np.array(hand.torques)
    assert np.isfinite(torques).all()
    assert (np.abs(torques) <= ROBOT.effort_limits).all()


def test_no_torque_leaves_a_controller_that_is_not_active(module_node: Node, hand: SimulatedHand) -> None:
    assert not change_state(module_node, NODE, DEACTIVATE)  # it is not active yet
    offered = itertools.count()

    def enough() -> bool:
        hand.offer(hand.state())
        return next(offered) > 50

    spin_until(module_node, enough)
    # The answer to the request comes after all that was done before it
    assert change_state(module_node, NODE, ACTIVATE, DEACTIVATE)
    assert not hand.answered()
    spin_until(module_node, lambda: next(offered) > 60)
    assert not hand._answers


def test_each_joint_state_is_answered_and_the_robot_stays_where_it_is_without_reference(
    hand: SimulatedHand, active: Inbox
) -> None:
    for _ in range(200):
        hand.tick()  # waits for torques with the stamp of the state
    assert_within_limits(hand)
    assert np.abs(hand.simulator.state.v).max() < 0.02
    np.testing.assert_allclose(hand.simulator.state.q, ROBOT.home, atol=0.01)
    assert active.last.state == ControllerState.DAMPING
    assert "no reference yet" in active.last.reason


def test_a_reference_at_1_khz_is_followed_then_held_then_let_go_of_and_each_change_says_why(
    hand: SimulatedHand, active: Inbox
) -> None:
    for _ in range(20):
        hand.tick()
    goal = hand.pose + np.array([0.0, 0.04, 0.03, 0.0, 0.0, 0.0, 0.0])
    follow(hand, goal, 900)
    assert active.last.state == ControllerState.ACTIVE
    assert np.linalg.norm(hand.pose[:3] - goal[:3]) < 0.01
    assert len(active.last.stiffness) == 36 and active.last.joints == NAMES
    held = wait_for_state(hand, active, ControllerState.HOLD)
    assert "no reference for 0.1 s" in held.reason
    assert np.linalg.norm(hand.pose[:3] - goal[:3]) < 0.01
    wait_for_state(hand, active, ControllerState.DAMPING)
    for _ in range(600):
        hand.tick()
    assert active.last.state == ControllerState.DAMPING and "no reference for 0.4 s" in active.last.reason
    order = [ControllerState.DAMPING, ControllerState.ACTIVE, ControllerState.HOLD, ControllerState.DAMPING]
    assert states_of(active)[-4:] == order
    assert_within_limits(hand)
    assert steps(hand).max() < GENTLE


def test_a_reference_far_away_is_approached_without_leap_or_limit_exceeded(hand: SimulatedHand, active: Inbox) -> None:
    for _ in range(20):
        hand.tick()
    follow(hand, hand.pose + np.array([0.3, 0.3, 0.3, 0.0, 0.0, 0.0, 0.0]), 300)
    assert_within_limits(hand)
    assert steps(hand).max() < GENTLE


def with_nan_mean(message: ReferenceMessage) -> None:
    message.gaussian.mean[0] = float("nan")


def with_zero_quaternion(message: ReferenceMessage) -> None:
    message.gaussian.mean = array("d", [0.6, 0.2, 0.1, 0.0, 0.0, 0.0, 0.0])


def on_a_plane(message: ReferenceMessage) -> None:
    message.gaussian.manifold = "euclidean"
    message.gaussian.mean = array("d", [0.5, 0.2])
    message.gaussian.covariance = array("d", [1.0, 0.0, 0.0, 1.0])


def on_no_manifold(message: ReferenceMessage) -> None:
    message.gaussian.manifold = "R3 x SE7"


def of_wrong_size(message: ReferenceMessage) -> None:
    message.gaussian.covariance = array("d", np.eye(7).ravel())


def without_numbers(message: ReferenceMessage) -> None:
    message.gaussian.mean = array("d")


def with_indefinite_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance = array("d", np.diag([1e-4, 1e-4, -1e-4, 1.0, 1.0, 1.0]).ravel())


def with_zero_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance = array("d", np.zeros(36))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (with_nan_mean, "not finite"),
        (with_zero_quaternion, "quaternion"),
        (on_a_plane, "expected a pose on 'R3 x S3'"),
        (on_no_manifold, "SE7"),
        (of_wrong_size, "49 in its covariance; expected 7 and 36"),
        (without_numbers, "0 numbers"),
        (with_indefinite_covariance, "positive definite"),
        (with_zero_covariance, "positive definite"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_reference_that_cannot_be_used_is_refused_with_the_reason_and_not_followed(
    hand: SimulatedHand, active: Inbox, process: RunningProcess, spoil: object, reason: str
) -> None:
    said = len(process.output)

    def refused() -> bool:
        message = pose_reference(hand.pose, hand.stamp_ns)
        spoil(message)  # type: ignore[operator]
        hand.tick(message)
        words = [item.reason for item in active.messages] + process.output[said:].splitlines()
        return any(reason in line for line in words)

    spin_until(hand.node, refused, message=f"'{reason}' in the state or the log")
    for _ in range(20):
        hand.tick()
    assert ControllerState.ACTIVE not in states_of(active)
    # Not to and fro at every tick
    assert len(states_of(active)) < 6
    assert_within_limits(hand)
    np.testing.assert_allclose(hand.simulator.state.q, ROBOT.home, atol=0.01)


@pytest.mark.parametrize("fault", ["not finite", "numbers for", "velocity is empty"])
def test_a_joint_state_that_cannot_be_used_is_a_fault_with_its_reason_and_the_weight_is_carried_as_before(
    hand: SimulatedHand, active: Inbox, fault: str
) -> None:
    for _ in range(5):
        before = hand.tick()

    def refused() -> bool:
        state = hand.state()
        if fault == "not finite":
            state.position[3] = float("nan")
        elif fault == "numbers for":
            state.velocity = state.velocity[:-2]
        else:
            state.velocity = array("d")
        answer = hand.tick(state=state)
        assert (np.abs(answer - before) <= 0.1 * ROBOT.effort_limits).all()
        return active.last.state == ControllerState.FAULT

    spin_until(hand.node, refused, message="FAULT")
    assert fault in active.last.reason
    wait_for_state(hand, active, ControllerState.DAMPING)
    assert_within_limits(hand)


def test_joints_are_matched_by_name_in_whatever_order_they_come(hand: SimulatedHand, active: Inbox) -> None:
    order = np.random.default_rng(0).permutation(len(NAMES))
    for _ in range(50):
        usual = hand.tick()
        state = hand.state()
        shuffled = hand.state()
        shuffled.name = [NAMES[i] for i in order]
        for name in ("position", "velocity", "effort"):
            setattr(shuffled, name, array("d", np.asarray(getattr(state, name))[order]))
        assert (np.abs(hand.tick(state=shuffled) - usual) <= GENTLE * ROBOT.effort_limits).all()


def test_parameters_out_of_range_and_combinations_without_sense_are_refused_as_a_whole(
    module_node: Node, hand: SimulatedHand
) -> None:
    result = set_parameters(module_node, NODE, reference_timeout=-1.0)
    assert not result.successful and "reference_timeout" in result.reason
    result = set_parameters(module_node, NODE, blend_time=0.4, min_stiffness=200.0, max_stiffness=100.0)
    assert not result.successful and "min_stiffness" in result.reason and "max_stiffness" in result.reason
    result = set_parameters(module_node, NODE, endpoint="right")
    assert not result.successful
    assert set_parameters(module_node, NODE, min_stiffness=20.0, max_stiffness=2000.0).successful


def test_a_robot_file_that_is_none_fails_the_configuration_with_the_reason(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    process = start_process(NODE, *ros_arguments(robot_file=tmp_path / "nowhere.yaml"))
    assert not change_state(ros_node, NODE, CONFIGURE)
    assert "nowhere.yaml" in process.output and "Traceback" not in process.output
    assert not change_state(ros_node, NODE, ACTIVATE)
    assert process.returncode is None


def test_slow_joint_states_and_timeouts_that_are_too_short_for_them_are_warned_of(
    ros_node: Node, start_process: StartProcess
) -> None:
    process = start_process(NODE, *ros_arguments(robot_file=ROBOT_FILE, joint_state_rate=100.0, max_time_step=0.01))
    assert change_state(ros_node, NODE, CONFIGURE)
    warning = "joint_state_timeout is 0.02 s, but joint states come every 0.01 s (joint_state_rate): set it to 0.03 s"
    spin_until(ros_node, lambda: warning in process.output, message="the warning", processes=(process,))
    assert "max_time_step is" not in process.output
