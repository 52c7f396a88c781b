# SPDX-License-Identifier: Apache-2.0
"""An impedance_controller whose arm is held by hand says so, is soft, comes back, and says what it cannot feel."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import (
    ACTIVATE,
    ALL,
    ALL_LATCHED,
    CONFIGURE,
    DEACTIVATE,
    ROBOT_FILE,
    Inbox,
    change_state,
    ros_arguments,
    set_parameters,
)
from ros_testing import StartProcess, spin_until
from simulated_hand import ROBOT, SimulatedHand, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros.messages.qos import STREAM

NODE, LINK, THRESHOLD = "impedance_controller", "left_gripper", 15.0
PUSH = np.array([0.0, 0.0, 30.0, 0.0, 0.0, 0.0])
#: No torque moves by more than this share of its limit from one state to the next, 4 ms later.
GENTLE = 0.08


class Held:
    """A hand that is to stay where it is, the controller's states, and what it says of the force."""

    def __init__(self, node: Node, hand: SimulatedHand) -> None:
        self.hand, self.goal = hand, hand.pose
        self.states = Inbox(node, ControllerState, "controller_state", ALL_LATCHED)
        self._diagnostics = Inbox(node, DiagnosticArray, "/diagnostics", ALL)

    def go(
        self, until: Callable[[], object], message: str, state: Callable[[], JointState | None] = lambda: None
    ) -> None:
        def goes() -> bool:
            self.hand.tick(pose_reference(self.goal, self.hand.stamp_ns, 0.005), state())
            return bool(until())

        spin_until(self.hand.node, goes, message=message)

    def says(self, words: str) -> bool:
        return bool(self.states.messages) and words in self.states.last.reason

    def distance(self) -> float:
        """From where the hand is to be, m."""
        return float(np.linalg.norm(self.hand.pose[:3] - self.goal[:3]))

    def force(self) -> str:
        """As in the newest diagnostics of the node."""
        told = [
            pair.value
            for array in self._diagnostics.messages
            for status in array.status
            for pair in status.values
            if status.name.startswith(NODE) and pair.key == "hand_force"
        ]
        return told[-1] if told else ""


@pytest.fixture
def held(ros_node: Node, start_process: StartProcess) -> Iterator[Held]:
    values = {"joint_state_timeout": 5.0, "max_age": 0.0, "joint_state_rate": 250.0}
    process = start_process(NODE, *ros_arguments(robot_file=ROBOT_FILE, **values))
    assert change_state(ros_node, NODE, CONFIGURE)
    hand = SimulatedHand(ros_node, process, ms=4)
    spin_until(
        ros_node,
        lambda: hand.states.get_subscription_count() and hand.references.get_subscription_count(),
        message="the controller to listen",
    )
    assert change_state(ros_node, NODE, ACTIVATE)
    assert not ros_node.count_subscribers("external_wrench"), "what is not asked for costs nothing"
    assert set_parameters(ros_node, NODE, yield_force=THRESHOLD).successful
    spin_until(ros_node, lambda: ros_node.count_subscribers("external_wrench"), message="the controller to listen")
    yield Held(ros_node, hand)
    assert change_state(ros_node, NODE, DEACTIVATE)


def test_an_arm_that_is_held_yields_says_why_and_comes_back(held: Held) -> None:
    hand = held.hand
    begun = hand.stamp_ns
    held.go(
        lambda: hand.stamp_ns - begun > 1_500_000_000 and "by joint torques" in held.force(), "a force that is known"
    )
    assert held.states.last.state == ControllerState.ACTIVE and "beginning" not in held.force(), held.force()
    firm = np.array(held.states.last.stiffness).reshape(6, 6)[2, 2]

    hand.wrenches = {LINK: PUSH}
    held.go(lambda: held.says(f"held with more than {THRESHOLD:g} N"), "the hold to be felt")
    assert held.states.last.state == ControllerState.HOLD
    held.go(lambda: held.distance() > 0.06, "a soft arm to be led away")
    assert np.array(held.states.last.stiffness).reshape(6, 6)[2, 2] < 0.3 * firm

    hand.wrenches = {}
    held.go(lambda: held.states.last.state == ControllerState.ACTIVE, "the arm to follow again")
    assert held.distance() < 0.05
    change = np.abs(np.diff(hand.torques, axis=0)) / ROBOT.effort_limits
    print(f"\nlargest change {change.max():.3f}")
    assert change.max() < GENTLE


def test_an_arm_that_measures_nothing_says_so_and_feels_a_sensor_at_its_hand(held: Held) -> None:
    hand = held.hand
    sensor = hand.node.create_publisher(WrenchStamped, "external_wrench", STREAM)

    def unmeasured() -> JointState:
        state = hand.state()
        state.effort = [0.0] * len(state.effort)
        return state

    held.go(lambda: "cannot be known: all joint torques" in held.force(), "words about the force", unmeasured)
    hand.wrenches = {LINK: PUSH}
    pushed = hand.stamp_ns
    held.go(lambda: hand.stamp_ns - pushed > 600_000_000, "a push that nobody measures", unmeasured)
    assert not any("held" in message.reason for message in held.states.messages)

    def measured(force: float) -> Callable[[], JointState]:
        def sends() -> JointState:
            message = WrenchStamped()
            message.header.frame_id = LINK
            message.wrench.force.z = force
            sensor.publish(message)
            return unmeasured()

        return sends

    hand.wrenches = {}
    held.go(lambda: "by external_wrench" in held.force(), "the sensor to be heard", measured(1.0))
    free = hand.stamp_ns
    held.go(lambda: hand.stamp_ns - free > 600_000_000, "a free hand", measured(1.0))
    held.go(lambda: held.says("the hand is held"), "the hold to be felt", measured(30.0))
