# SPDX-License-Identifier: Apache-2.0
"""How motions leave for robots that take no torques: positions of joints, or poses and velocities of a hand.

Each output is a row of ``OUTPUTS``: a topic, its type, and what a motion makes of it. A trajectory always ends at rest:
its first point is where the joints are to be, its second where they stop from there. So a robot comes to rest by
itself where no further message comes, and controllers accept it that refuse trajectories with an end that moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import COMMANDS

#: Shortest time from the first to the second point of a trajectory, s: of joints that rest already.
SHORTEST_STOP = 0.01


@dataclass(frozen=True, slots=True)
class Motion:
    """What leaves at a time.

    Parameters
    ----------
    joints
        n names, in the order of the numbers
    q, v
        (n,), positions and velocities
    horizon
        s from now at which joints are to be there
    stop_q, stop_time
        (n,), where joints come to rest, and how long that takes from there, s
    pose, twist
        (7,) and (6,) of the hand in the base frame, of these joints
    stiffness
        (6,) of the hand, N/m and N m/rad; None where no covariance of a pose is known
    stamp_ns, frame_id
        now, and the base frame
    """

    joints: Sequence[str]
    q: Array
    v: Array
    horizon: float
    stop_q: Array
    stop_time: float
    pose: Array
    twist: Array
    stiffness: Array | None
    stamp_ns: int
    frame_id: str


@dataclass(frozen=True, slots=True)
class MotionOutput:
    """One way for motions to leave: `make` returns the message, None where there is nothing to say."""

    message: type
    topic: str
    make: Callable[[Motion], Any]


def joint_trajectory(motion: Motion) -> JointTrajectory:
    """`trajectory_msgs/JointTrajectory` for a joint_trajectory_controller; a stamp of 0 means: from now on."""
    stop = motion.horizon + max(motion.stop_time, SHORTEST_STOP)
    return JointTrajectory(
        joint_names=list(motion.joints),
        points=[
            JointTrajectoryPoint(
                positions=conversions.floats(motion.q),
                velocities=conversions.floats(motion.v),
                time_from_start=_duration(motion.horizon),
            ),
            JointTrajectoryPoint(
                positions=conversions.floats(motion.stop_q),
                velocities=conversions.floats(0.0 * motion.v),
                time_from_start=_duration(stop),
            ),
        ],
    )


def positions(motion: Motion) -> Float64MultiArray:
    """`std_msgs/Float64MultiArray`, positions alone in the order of the joints, for forward_command_controller."""
    return Float64MultiArray(data=conversions.floats(motion.q))


def pose(motion: Motion) -> PoseStamped:
    """`geometry_msgs/PoseStamped`, where the hand is to be."""
    return conversions.pose_stamped(motion.pose, motion.stamp_ns, motion.frame_id)


def twist(motion: Motion) -> TwistStamped:
    """`geometry_msgs/TwistStamped`, how the hand is to move."""
    message = TwistStamped(header=conversions.header_at(motion.stamp_ns, motion.frame_id))
    linear, angular = message.twist.linear, message.twist.angular
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = motion.twist.tolist()
    return message


def stiffness(motion: Motion) -> Float64MultiArray | None:
    """`std_msgs/Float64MultiArray`, six stiffnesses along the axes and about them."""
    return None if motion.stiffness is None else Float64MultiArray(data=conversions.floats(motion.stiffness))


OUTPUTS: Mapping[str, MotionOutput] = {
    "joint_trajectory": MotionOutput(JointTrajectory, "joint_trajectory_controller/joint_trajectory", joint_trajectory),
    "positions": MotionOutput(Float64MultiArray, "forward_position_controller/commands", positions),
    "target_pose": MotionOutput(PoseStamped, "target_pose", pose),
    "target_stiffness": MotionOutput(Float64MultiArray, "target_stiffness", stiffness),
    "target_frame": MotionOutput(PoseStamped, "target_frame", pose),
    "servo_pose": MotionOutput(PoseStamped, "servo_node/pose_target_cmds", pose),
    "servo_twist": MotionOutput(TwistStamped, "servo_node/delta_twist_cmds", twist),
}
#: The output that is an action, `control_msgs/FollowJointTrajectory`: no topic that is published.
ACTION = "follow_joint_trajectory"
NAMES = (*OUTPUTS, ACTION)
#: Those that say where joints are to be; the others leave that to the robot.
OF_JOINTS = ("joint_trajectory", "positions", ACTION)


class MotionOutputs:
    """Publishes motions on every topic that was asked for.

    Parameters
    ----------
    node
        a lifecycle node, which owns the publishers
    outputs
        some of `NAMES`

    Raises
    ------
    ValueError
        no output, an unknown or doubled one.
    """

    def __init__(self, node: LifecycleNode, outputs: Sequence[str]) -> None:
        check_outputs(outputs)
        self._publishers = [
            (node.create_lifecycle_publisher(OUTPUTS[name].message, OUTPUTS[name].topic, COMMANDS), OUTPUTS[name].make)
            for name in outputs
            if name in OUTPUTS
        ]

    def publish(self, motion: Motion) -> None:
        """Send a motion."""
        for publisher, make in self._publishers:
            if (message := make(motion)) is not None:
                publisher.publish(message)


def check_outputs(outputs: Sequence[str]) -> None:
    """Check names of outputs.

    Parameters
    ----------
    outputs
        some of `NAMES`

    Raises
    ------
    ValueError
        no output, an unknown or doubled one.
    """
    unknown = [name for name in outputs if name not in NAMES]
    if unknown:
        raise ValueError(f"outputs names {shown(unknown[0])}; expected some of {', '.join(NAMES)}")
    if not outputs or len(set(outputs)) != len(outputs):
        raise ValueError(f"outputs must name some of {', '.join(NAMES)}, each once; got {listed(outputs)}")


def _duration(seconds: float) -> Duration:
    whole, rest = divmod(round(1e9 * seconds), 1_000_000_000)
    return Duration(sec=whole, nanosec=rest)
