# SPDX-License-Identifier: Apache-2.0
"""Passes joint states on late, with their own stamps: `late_relay.py FROM TO`, until SIGINT or SIGTERM.

`delay` (std_msgs/Float64MultiArray) says how late, s, and by how much that varies, evenly, from one to the next, s.
None overtakes another: those that would wait for the one before.
"""

import sys
import threading
import time
from collections import deque

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.runtime.executor import StopFlag
from tpgmm_ros.runtime.scheduling import request_realtime

#: How often it is looked for what is due, s.
LOOK = 0.0005


def main() -> None:
    source, target = sys.argv[1:]
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stop = StopFlag()
    node, rng = rclpy.create_node("relay"), np.random.default_rng(0)
    publisher = node.create_publisher(JointState, target, STREAM)
    waiting: deque[tuple[float, JointState]] = deque()
    delay = [0.0, 0.0]

    def take(message: JointState) -> None:
        due = time.monotonic() + delay[0] + rng.uniform(-delay[1], delay[1])
        waiting.append((max(due, waiting[-1][0]) if waiting else due, message))

    def tell(message: Float64MultiArray) -> None:
        delay[:] = message.data

    node.create_subscription(JointState, source, take, STREAM)
    node.create_subscription(Float64MultiArray, "delay", tell, LATCHED)
    request_realtime(1)  # ahead of ordinary programs, behind the nodes
    receiver = threading.Thread(target=rclpy.spin, args=(node,), daemon=True)
    receiver.start()
    print("relaying", flush=True)
    while not stop.set:
        while waiting and waiting[0][0] <= time.monotonic():
            publisher.publish(waiting.popleft()[1])
        time.sleep(LOOK)
    rclpy.shutdown()
    receiver.join(1.0)


if __name__ == "__main__":
    main()
