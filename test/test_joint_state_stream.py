# SPDX-License-Identifier: Apache-2.0
"""Joint states as nodes follow them: of those that have waited together the newest, and what its stamp says."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_testing import spin_until
from tpgmm_core.observation.streams import SECOND, Stamp
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STATES, STREAM
from tpgmm_ros.nodes.joint_states import Heard, JointStateStream


@pytest.mark.parametrize(
    "came",
    [
        [1.0, 1.0, 1.0],  # a simulator repeats a state that nobody has answered
        [1.0, 1.01, 1.01],
        [1.0, 1.01, 1.0],  # overtaken on its way
    ],
)
def test_a_state_that_waited_beside_its_copies_is_new(came: list[float], ros_node: Node) -> None:
    heard: list[Heard] = []
    JointStateStream(ros_node, "joint_states", heard.append, ["elbow"], ("position",))
    publisher = ros_node.create_publisher(JointState, "joint_states", STREAM)
    spin_until(ros_node, lambda: publisher.get_subscription_count() == 1)

    def send(seconds: float) -> None:
        stamp_ns = round(seconds * SECOND)
        publisher.publish(conversions.joint_state_message(["elbow"], stamp_ns, np.full(1, seconds), np.zeros(1)))

    assert len(came) <= STATES.depth
    for seconds in came:  # none is served before all have come
        send(seconds)
    spin_until(ros_node, lambda: heard)
    assert [(item.kind, item.stamp_ns) for item in heard] == [(Stamp.NEW, round(max(came) * SECOND))]
    assert heard[0].values[0] == max(came)

    send(max(came))
    spin_until(ros_node, lambda: len(heard) == 2)
    assert heard[1].kind is Stamp.REPEATED
