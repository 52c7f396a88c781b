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
from tpgmm_ros.messages.qos import BROADCAST, LATCHED, TRANSFORMS_STATIC
from tpgmm_ros.messages.sources import TF_MESSAGE


class TransformBroadcaster:
    """Publishes poses as transforms on /tf, or those that never change on /tf_static.

    Parameters
    ----------
    node
        that publishes
    is_static
        whether they never change

    Raises
    ------
    ModuleNotFoundError
        tf2_msgs is not installed
    """

    def __init__(self, node: Node, is_static: bool = False) -> None:
        self._message = message_class(TF_MESSAGE)
        topic, qos = ("/tf_static", TRANSFORMS_STATIC) if is_static else ("/tf", BROADCAST)
        self._publisher = node.create_publisher(self._message, topic, qos)

    def send(self, stamp_ns: int, poses: Mapping[tuple[str, str], Array]) -> None:
        """Publish poses at a time.

        Parameters
        ----------
        stamp_ns
            ns
        poses
            parent and child frame → (7,) of the child in the parent: x, y, z in m, qx, qy, qz, qw
        """
        if poses:
            self._publisher.publish(
                self._message(transforms=[_transform(stamp_ns, *frames, pose) for frames, pose in poses.items()])
            )


class RobotBroadcaster:
    """Publishes `robot_description` once, latched, and the links of the robot, as robot_state_publisher does.

    Each link is published in the one that it stands on, as in the URDF: those that a joint moves on /tf, the others
    once on /tf_static. Viewers that read the URDF too expect the same tree.

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
        self._moving, fixed = (
            {
                (parent, link): (robot.frame_id(parent), robot.frame_id(link))
                for link, (parent, is_fixed) in robot.link_parents.items()
                if is_fixed is wanted
            }
            for wanted in (False, True)
        )
        self._transforms = TransformBroadcaster(node)
        self._fixed = TransformBroadcaster(node, is_static=True)
        data = robot.create_data()
        data.update(robot.home)
        now_ns = node.get_clock().now().nanoseconds
        self._fixed.send(now_ns, {frames: data.relative_pose(*ids) for frames, ids in fixed.items()})
        self._description = node.create_publisher(String, "robot_description", LATCHED)
        self._description.publish(String(data=robot.urdf.read_text(encoding="utf-8")))

    def send(self, data: RobotData, stamp_ns: int) -> None:
        """Publish where the links are, for data that were updated, at a time (ns)."""
        self._transforms.send(stamp_ns, {frames: data.relative_pose(*ids) for frames, ids in self._moving.items()})


def _transform(stamp_ns: int, parent: str, child: str, pose: Array) -> TransformStamped:
    x, y, z, qx, qy, qz, qw = map(float, pose)
    message = TransformStamped(header=conversions.header_at(stamp_ns, parent), child_frame_id=child)
    message.transform.translation = Vector3(x=x, y=y, z=z)
    message.transform.rotation = Quaternion(x=qx, y=qy, z=qz, w=qw)
    return message
