# SPDX-License-Identifier: Apache-2.0
"""Each law of the controller node on its topics, with a simulated Baxter."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.node import Node

from ros_graph import ACTIVATE, ALL_LATCHED, CONFIGURE, ROBOT_FILE, Inbox, change_state, ros_arguments
from ros_testing import StartProcess, spin_until
from simulated_hand import DIMENSIONS, POSE, ROBOT, SimulatedHand
from tpgmm_core import Gaussian
from tpgmm_core.control.laws import LAWS
from tpgmm_core.model.reference import Reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros.messages import conversions

NODE = "impedance_controller"


# In lockstep plans are made within the step, else by a thread beside it
@pytest.mark.parametrize(("law", "lockstep"), [*((law, True) for law in LAWS), ("predictive", False)])
def test_a_law_follows_and_says_of_which_terms_its_torques_are_the_sum(
    ros_node: Node, start_process: StartProcess, law: str, lockstep: bool
) -> None:
    process = start_process(
        NODE, *ros_arguments(robot_file=ROBOT_FILE, law=law, lockstep=lockstep, joint_state_timeout=5.0, max_age=0.0)
    )
    assert change_state(ros_node, NODE, CONFIGURE)
    assert change_state(ros_node, NODE, ACTIVATE)
    states, hand = Inbox(ros_node, ControllerState, "controller_state", ALL_LATCHED), SimulatedHand(ros_node, process)
    spin_until(
        ros_node,
        lambda: hand.states.get_subscription_count() and hand.references.get_subscription_count(),
        message="the controller to listen",
    )
    goal = hand.pose + np.array([0.0, 0.02, 0.02, 0.0, 0.0, 0.0, 0.0])
    gaussian = Gaussian(goal, np.diag([0.01**2] * 3 + [0.1**2] * 3), POSE)
    reference = Reference(0.5, gaussian, 0.05, (gaussian,) * 10, np.ones(1), ("object",))
    for _ in range(900):
        stamp_ns = hand.stamp_ns + 1_000_000
        hand.tick(conversions.reference_message(reference, DIMENSIONS, stamp_ns, ROBOT.base_frame))
    assert np.linalg.norm(hand.pose[:3] - goal[:3]) < 0.01
    assert (np.abs(hand.torques) <= ROBOT.effort_limits).all()
    told = states.last
    assert told.state == ControllerState.ACTIVE
    terms = conversions.terms_of(told)
    assert {"feedforward", "feedback", "hold", "pipeline"} <= set(terms)
    sent = np.array(told.feedforward_torque) + np.array(told.feedback_torque)
    np.testing.assert_allclose(sum(terms.values()), sent, atol=1e-9)
    assert any(np.allclose(sent, tau, atol=1e-12) for tau in hand.torques)
