# SPDX-License-Identifier: Apache-2.0
"""Which clock watches over time-outs and loops."""

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock as ClockMessage


def loop_clock(node: Node) -> Clock:
    """The steady clock, which no step of the system's clock can stall; the simulation's clock under ``use_sim_time``,
    so that a simulation that runs faster or slower than real time meets the same time-outs.
    """
    if node.get_parameter("use_sim_time").value:
        return node.get_clock()
    return Clock(clock_type=ClockType.STEADY_TIME)


def clock_trouble(node: Node) -> str:
    """What is wrong with the clock that a node's stamps are of, in words; empty where nothing is."""
    if node.get_parameter("use_sim_time").value and not node.get_clock().now().nanoseconds:
        return (
            "no time on /clock, though use_sim_time is true: start what publishes it (a simulator, or baxter_simulator "
            "with lockstep), or set use_sim_time to false"
        )
    return ""


def guard_clock() -> None:
    """From now on a time on ``/clock`` that is none is refused: rclpy would raise in its callback and end the node."""
    take = TimeSource.clock_callback

    def guarded(self: TimeSource, message: ClockMessage) -> None:
        time = message.clock
        if time.sec >= 0 and time.nanosec < 1_000_000_000:
            take(self, message)
        elif (node := self._get_node()) is not None:
            node.get_logger().error(
                f"time on /clock refused: {time.sec} s and {time.nanosec} ns; expected at least 0, and below 1e9",
                throttle_duration_sec=1.0,
            )

    TimeSource.clock_callback = guarded  # type: ignore[method-assign, assignment]
