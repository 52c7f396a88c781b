# SPDX-License-Identifier: Apache-2.0
"""The interface package: what one process sends, another one receives."""

import array
import sys

import numpy as np
import pytest
from rclpy.node import Node

from ros_testing import StartProcess, spin_until
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import ControllerState, Gaussian, Reference, TaskFrame, TaskParameters
from tpgmm_msgs.srv import LoadModel

# Sends every message on `echo/<topic>` back on `<topic>`
ECHO = """
import rclpy
from rclpy.executors import ExternalShutdownException
from tpgmm_msgs.msg import ControllerState, Reference, TaskParameters

rclpy.init()
node = rclpy.create_node("echo")
for message_type in (ControllerState, Reference, TaskParameters):
    publisher = node.create_publisher(message_type, message_type.__name__, 1)
    node.create_subscription(message_type, "echo/" + message_type.__name__, publisher.publish, 1)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


def pose_gaussian() -> Gaussian:
    covariance = np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    return Gaussian(
        manifold="R3 x S3",
        mean=array.array("d", [0.5, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0]),
        covariance=array.array("d", covariance.ravel()),
    )


def task_parameters() -> TaskParameters:
    frame = TaskFrame(name="object", status=TaskFrame.HELD, confidence=0.5, rows=2, cols=3)
    frame.a = array.array("d", range(6))
    frame.b = array.array("d", [1.0, 2.0])
    message = TaskParameters(frames=[frame, TaskFrame(name="target", status=TaskFrame.MISSING)])
    message.header.frame_id = "base"
    return message


def reference() -> Reference:
    return Reference(
        phase=0.25,
        dimensions=["x", "y", "z", "qx", "qy", "qz", "qw"],
        gaussian=pose_gaussian(),
        horizon_time_step=0.01,
        horizon=[pose_gaussian(), pose_gaussian()],
        activations=[0.25, 0.75],
        frames=["object", "robot"],
    )


def controller_state() -> ControllerState:
    return ControllerState(
        state=ControllerState.HOLD,
        reason="no reference for 0.1 s",
        stiffness=np.eye(6).ravel(),
        damping=2.0 * np.eye(6).ravel(),
        joints=["left_s0", "left_s1"],
        feedforward_torque=[1.0, -2.0],
        feedback_torque=[0.5, 0.25],
    )


@pytest.mark.parametrize(
    "message",
    [task_parameters(), reference(), controller_state()],
    ids=lambda message: type(message).__name__,
)
def test_messages_cross_topics_between_processes_unchanged(
    ros_node: Node, start_process: StartProcess, message: TaskParameters | Reference | ControllerState
) -> None:
    echo = start_process(sys.executable, "-c", ECHO)
    name = type(message).__name__
    received: list[object] = []
    ros_node.create_subscription(type(message), name, received.append, 1)
    publisher = ros_node.create_publisher(type(message), f"echo/{name}", 1)

    def answered() -> bool:
        publisher.publish(message)
        return bool(received)

    spin_until(ros_node, answered, message=f"{name} coming back", processes=(echo,))
    assert received[0] == message


def test_statuses_and_states_have_the_numbers_that_recordings_hold() -> None:
    assert (TaskFrame.VISIBLE, TaskFrame.HELD, TaskFrame.MISSING) == (0, 1, 2)
    states = (
        ControllerState.WAITING,
        ControllerState.ACTIVE,
        ControllerState.HOLD,
        ControllerState.DAMPING,
        ControllerState.FAULT,
    )
    assert states == (0, 1, 2, 3, 4)


def test_service_and_action_have_the_fields_of_the_contract() -> None:
    assert list(LoadModel.Request.get_fields_and_field_types()) == ["path"]
    assert list(LoadModel.Response.get_fields_and_field_types()) == ["success", "reason"]
    assert list(Reproduce.Goal.get_fields_and_field_types()) == [
        "model",
        "duration",
        "models",
        "durations",
        "holds",
    ]
    assert list(Reproduce.Result.get_fields_and_field_types()) == [
        "success",
        "reason",
        "final_position_error",
        "final_orientation_error",
    ]
    assert list(Reproduce.Feedback.get_fields_and_field_types()) == [
        "phase",
        "frames",
        "skill",
        "skills",
        "skill_name",
        "waits",
    ]
