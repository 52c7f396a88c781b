# SPDX-License-Identifier: Apache-2.0
"""Publishes poses as fast as it is told: `flood.py TOPIC RATE x y z qx qy qz qw`, until SIGINT or SIGTERM.

At its end it prints how many poses per second it has published.
"""

import sys
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.signals import SignalHandlerOptions

from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.runtime.executor import StopFlag
from tpgmm_ros.runtime.scheduling import request_realtime


def main() -> None:
    topic, rate, *pose = sys.argv[1:]
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stop = StopFlag()
    node = rclpy.create_node("flood")
    publisher = node.create_publisher(PoseStamped, topic, STREAM)
    message = conversions.pose_stamped(np.array(pose, dtype=float), 0, "base")
    request_realtime(1)  # ahead of ordinary programs, behind the nodes
    print("flooding", flush=True)
    began, count = time.monotonic(), 0
    while not stop.set:
        while count < float(rate) * (time.monotonic() - began) and not stop.set:
            message.header.stamp = conversions.time_from_ns(time.time_ns())
            publisher.publish(message)
            count += 1
        time.sleep(0.0005)
    print(f"published per second: {count / (time.monotonic() - began):.0f}", flush=True)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
