# SPDX-License-Identifier: Apache-2.0
"""The host of the camera in `networks`: publishes the poses that come on its standard input, one a line."""

from __future__ import annotations

import json
import sys

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from benchmarks.lossy_switch import require_own_network
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.runtime.executor import init
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task


def main() -> None:
    """Publish until the input ends."""
    task = Task.load(config_file("pick_place.yaml"))
    require_own_network()
    init([])
    node = Node("camera")
    publishers = {name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()}
    for line in sys.stdin:
        name, stamp_ns, pose = json.loads(line)
        publishers[name].publish(conversions.pose_stamped(pose, stamp_ns, task.base_frame))
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
