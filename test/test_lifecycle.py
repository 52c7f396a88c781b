# SPDX-License-Identifier: Apache-2.0
"""Lifecycle nodes go up and down as often as one likes, while messages come all the time, and leave nothing behind."""

import numpy as np
import pytest
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ACTIVATE, CLEANUP, CONFIGURE, DEACTIVATE, ROBOT_FILE, TASK_FILE, change_state, ros_arguments
from ros_testing import StartProcess, spin_until
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM

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

    states = ros_node.create_publisher(JointState, "joint_states", STREAM)
    now = ros_node.get_clock().now
    message = conversions.joint_state_message(["left_s0"], 0, np.zeros(1), np.zeros(1))

    def publish() -> None:
        for _ in range(5):  # so that some wait when topics go
            message.header.stamp = now().to_msg()
            states.publish(message)

    stream = ros_node.create_timer(0.002, publish)

    def counts() -> dict[str, int]:
        found = {topic: ros_node.count_publishers(topic) for topic in published}
        return found | {topic: ros_node.count_subscribers(topic) for topic in subscribed}

    def wait_until_each_exists(times: int) -> None:
        def all_do() -> bool:
            return set(counts().values()) == {times}

        try:
            spin_until(ros_node, all_do, processes=(process,))
        except AssertionError as error:
            raise AssertionError(f"expected each topic {times} times, found {counts()}") from error

    for _ in range(2):
        assert change_state(ros_node, name, CONFIGURE, ACTIVATE)
        wait_until_each_exists(1)
        assert change_state(ros_node, name, DEACTIVATE, CLEANUP)
        wait_until_each_exists(0)
    ros_node.destroy_timer(stream)
    assert "Traceback" not in process.output
