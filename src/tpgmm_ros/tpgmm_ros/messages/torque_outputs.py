# SPDX-License-Identifier: Apache-2.0
"""How torques leave for what drives the motors: as messages of this project's robots, or of ros2_control's controllers.

Each output is a row of ``OUTPUTS``. Messages of packages that may be missing are imported when they are asked for; what
they hold is worked out without them, as the fields of a message by name.

Of `control_msgs`, ``MultiDOFCommand`` is the one that commands efforts, by the names of the joints: the reference of
ros2_controllers' pid_controller, which closes a loop of torque where the joints measure it. ``JointJog`` moves by
displacements, and the states of controllers are what they publish, not what they take.
"""

from __future__ import annotations

import importlib
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import Pose
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.control.controller import TorqueCommand
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import COMMANDS, STREAM

Fields = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Leaving:
    """What leaves for n joints: torques and the state that they answer to, in the order of the names.

    Parameters
    ----------
    joints
        (n,), places of the joints in the command's vectors
    tau
        (n,), N m (N); without gravity where the robot adds it itself
    command
        what it comes from, for all joints of the robot
    """

    names: list[str]
    joints: NDArray[np.intp]
    stamp_ns: int
    tau: Array
    command: TorqueCommand

    def gain(self) -> Array:
        """(n, 2 n): how the torques would fall with positions and velocities that rise; zero for the safe torque."""
        n, law = len(self.joints), self.command.law
        if law is None:
            return np.zeros((n, 2 * n))
        block = np.ix_(self.joints, self.joints)
        return np.hstack([gains[block] for gains in law.joint_gains()])


@dataclass(frozen=True, slots=True)
class TorqueOutput:
    """One way for torques to leave.

    Parameters
    ----------
    package, message
        the message, `package.msg.message`
    fields
        the fields of the message by name, those of messages within it as a mapping or as the message
    """

    package: str
    message: str
    topic: str
    qos: QoSProfile
    fields: Callable[[Leaving], Fields]


def joint_state(leaving: Leaving) -> Fields:
    """`sensor_msgs/JointState`: efforts by name."""
    header = conversions.header_at(leaving.stamp_ns, "")
    return {"header": header, "name": leaving.names, "effort": conversions.floats(leaving.tau)}


def multi_array(leaving: Leaving) -> Fields:
    """`std_msgs/Float64MultiArray`: efforts alone, in the order of the joints, for effort_controllers."""
    return {"data": conversions.floats(leaving.tau)}


def multi_dof_command(leaving: Leaving) -> Fields:
    """`control_msgs/MultiDOFCommand`: efforts by name, for pid_controller."""
    no_rates: array[float] = array("d")
    return {"dof_names": leaving.names, "values": conversions.floats(leaving.tau), "values_dot": no_rates}


def linear_feedback(leaving: Leaving) -> Fields:
    """`linear_feedback_controller_msgs/Control`: u = feedforward + gain (x_0 - x), x = [q, v].

    It goes on at the rate of the motors between two of these messages. x_0 is the state that was measured, at which
    the torques are exactly those that leave otherwise; the gain is how they would change with the state: the LQR's
    stiffness and damping as the joints feel them, [K, D].

    Parameters
    ----------
    leaving
        what leaves the controller

    Returns
    -------
    Fields
        the fields of the message
    """
    q, v = leaving.command.q[leaving.joints], leaving.command.v[leaving.joints]
    return {
        "header": conversions.header_at(leaving.stamp_ns, ""),
        "feedback_gain": matrix_message(leaving.gain()),
        "feedforward": matrix_message(leaving.tau[:, None]),
        "initial_state": {
            "header": conversions.header_at(leaving.stamp_ns, ""),
            "base_pose": Pose(),  # a fixed base: the identity
            "joint_state": conversions.joint_state_message(leaving.names, leaving.stamp_ns, q, v, leaving.tau),
        },
    }


def matrix_message(matrix: Array) -> Float64MultiArray:
    """A matrix (n, m), row by row, with its layout."""
    rows, cols = matrix.shape
    layout = MultiArrayLayout(
        dim=[
            MultiArrayDimension(label="rows", size=rows, stride=rows * cols),
            MultiArrayDimension(label="cols", size=cols, stride=cols),
        ]
    )
    return Float64MultiArray(layout=layout, data=conversions.floats(matrix))


OUTPUTS: Mapping[str, TorqueOutput] = {
    "joint_state": TorqueOutput("sensor_msgs", "JointState", "joint_torques", STREAM, joint_state),
    "effort_controller": TorqueOutput(
        "std_msgs", "Float64MultiArray", "effort_controller/commands", COMMANDS, multi_array
    ),
    "pid_controller": TorqueOutput(
        "control_msgs", "MultiDOFCommand", "pid_controller/reference", COMMANDS, multi_dof_command
    ),
    "linear_feedback_controller": TorqueOutput(
        "linear_feedback_controller_msgs", "Control", "control", COMMANDS, linear_feedback
    ),
}


def message_class(name: str) -> Any:
    """The message of an output.

    Parameters
    ----------
    name
        of the output

    Returns
    -------
    Any
        the class

    Raises
    ------
    ValueError
        unknown output, or its message is not installed
    """
    output = OUTPUTS.get(name)
    if output is None:
        raise ValueError(f"torque_outputs names {shown(name)}; expected some of {', '.join(OUTPUTS)}")
    try:
        return getattr(importlib.import_module(f"{output.package}.msg"), output.message)
    except (ImportError, AttributeError) as error:  # a package may be there in part, as `make setup` builds it
        raise ValueError(
            f"the torque output '{name}' needs {output.message} of {output.package}, which cannot be imported "
            f"({error}); install it (apt install ros-jazzy-{output.package.replace('_', '-')}) or take '{name}' out of "
            "torque_outputs"
        ) from error


def filled(message: Any, fields: Fields) -> Any:
    """A message with its fields set; a mapping fills the message that is there."""
    for name, value in fields.items():
        if isinstance(value, Mapping):
            filled(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


class TorqueOutputs:
    """Publishes torques in every way that was asked for.

    Parameters
    ----------
    node
        a lifecycle node, which owns the publishers
    robot
        the robot
    outputs
        names of `OUTPUTS`
    joints
        the group of the robot file whose torques leave, in its order; empty: all joints
    gravity_compensated
        what drives the robot adds the torques of gravity itself, so that they are left out

    Raises
    ------
    ValueError
        no output, an unknown or doubled one, a package that is not installed, an unknown group.
    """

    def __init__(
        self, node: LifecycleNode, robot: RobotModel, outputs: Sequence[str], joints: str, gravity_compensated: bool
    ) -> None:
        if not outputs or len(set(outputs)) != len(outputs):
            raise ValueError(f"torque_outputs must name some of {', '.join(OUTPUTS)}, each once; got {listed(outputs)}")
        if joints and joints not in robot.joint_groups:
            raise ValueError(
                f"torque_joints names no joint group of the robot file: {shown(joints)}; "
                f"it has {listed(robot.joint_groups)}"
            )
        classes = [message_class(name) for name in outputs]
        self._data = robot.create_data() if gravity_compensated else None
        self._joints = robot.indices(joints or robot.joint_names)
        self._names = [robot.joint_names[i] for i in self._joints]
        self._publishers = [
            (node.create_lifecycle_publisher(message, OUTPUTS[name].topic, OUTPUTS[name].qos), message, OUTPUTS[name])
            for name, message in zip(outputs, classes, strict=True)
        ]

    def publish(self, command: TorqueCommand, stamp_ns: int) -> None:
        """Send torques that answer the joint state of a stamp."""
        tau = command.tau if self._data is None else command.tau - self._data.gravity(command.q)
        leaving = Leaving(self._names, self._joints, stamp_ns, tau[self._joints], command)
        for publisher, message, output in self._publishers:
            publisher.publish(filled(message(), output.fields(leaving)))
