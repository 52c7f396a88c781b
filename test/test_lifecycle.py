# SPDX-License-Identifier: Apache-2.0
"""Lifecycle nodes go up and down as often as one likes, and leave nothing behind."""

import pytest
from rclpy.node import Node

from ros_graph import ACTIVATE, CLEANUP, CONFIGURE, DEACTIVATE, ROBOT_FILE, TASK_FILE, change_state, ros_arguments
from ros_testing import StartProcess, spin_until

NODES = {
    "impedance_controller": ({"robot_file": ROBOT_FILE}, ["joint_torques", "controller_state"], ["joint_states"]),
    "reproduction": ({"task_file": TASK_FILE}, ["reference", "markers"], ["joint_states", "task_parameters"]),
}


@pytest.mark.parametrize("name", NODES)
def test_clean_up_undoes_configuration_and_a_second_one_makes_each_topic_once(
    name: str, ros_node: Node, start_process: StartProcess
) -> None:
    parameters, published, subscribed = NODES[name]
    process = start_process(name, *ros_arguments(**parameters))

    def each_exists(times: int) -> bool:
        counts = [ros_node.count_publishers(topic) for topic in published]
        return counts + [ros_node.count_subscribers(topic) for topic in subscribed] == [times] * (
            len(published) + len(subscribed)
        )

    for _ in range(2):
        assert change_state(ros_node, name, CONFIGURE, ACTIVATE)
        spin_until(ros_node, lambda: each_exists(1), message="each topic once", processes=(process,))
        assert change_state(ros_node, name, DEACTIVATE, CLEANUP)
        spin_until(ros_node, lambda: each_exists(0), message="no topic left", processes=(process,))
