# SPDX-License-Identifier: Apache-2.0
"""What viewers are shown on request: frames on /tf, and the robot's links with its `robot_description`."""

from __future__ import annotations

from collections.abc import Mapping

from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from rclpy.node import Node
from std_msgs.msg import String

from tpgmm_core.common.types import Array
from tpgmm_core.robot.data import RobotData
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.classes import message_class
from tpgmm_ros.messages.qos import BROADCAST, LATCHED
from tpgmm_ros.messages.sources import TF_MESSAGE


class TransformBroadcaster:
    """Publishes poses as transforms on /tf.

    Parameters
    ----------
    node
        that publishes

    Raises
    ------
    ModuleNotFoundError
        tf2_msgs is not installed
    """

    def __init__(self, node: Node) -> None:
        self._message = message_class(TF_MESSAGE)
        self._publisher = node.create_publisher(self._message, "/tf", BROADCAST)

    def send(self, stamp_ns: int, parent: str, poses: Mapping[str, Array]) -> None:
        """Publish poses at a time.

        Parameters
        ----------
        stamp_ns
            ns
        parent
            frame in which the poses are expressed
        poses
            child frame → (7,), x, y, z in m, qx, qy, qz, qw
        """
        if poses:
            self._publisher.publish(
                self._message(transforms=[_transform(stamp_ns, parent, *item) for item in poses.items()])
            )


class RobotBroadcaster:
    """Publishes `robot_description` once, latched, and the links of the robot on /tf: as robot_state_publisher does.

    Parameters
    ----------
    node
        that publishes
    robot
        whose links

    Raises
    ------
    ModuleNotFoundError
        tf2_msgs is not installed
    OSError
        the URDF cannot be read
    """

    def __init__(self, node: Node, robot: RobotModel) -> None:
        self._transforms, self._base = TransformBroadcaster(node), robot.base_frame
        self._links = {name: robot.frame_id(name) for name in robot.links if name != robot.base_frame}
        self._description = node.create_publisher(String, "robot_description", LATCHED)
        self._description.publish(String(data=robot.urdf.read_text(encoding="utf-8")))

    def send(self, data: RobotData, stamp_ns: int) -> None:
        """Publish where the links are, for data that were updated, at a time (ns)."""
        poses = {name: data.frame_pose(frame_id) for name, frame_id in self._links.items()}
        self._transforms.send(stamp_ns, self._base, poses)


def _transform(stamp_ns: int, parent: str, child: str, pose: Array) -> TransformStamped:
    x, y, z, qx, qy, qz, qw = map(float, pose)
    message = TransformStamped(header=conversions.header_at(stamp_ns, parent), child_frame_id=child)
    message.transform.translation = Vector3(x=x, y=y, z=z)
    message.transform.rotation = Quaternion(x=qx, y=qy, z=qz, w=qw)
    return message
