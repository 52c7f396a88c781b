# SPDX-License-Identifier: Apache-2.0
"""Which clock watches over time-outs and loops."""

from rclpy.clock import Clock, ClockType
from rclpy.node import Node


def loop_clock(node: Node) -> Clock:
    """The clock of time-outs: the steady one, which no step of the system's clock can stall.

    Under ``use_sim_time`` it is the simulation's, so that a simulation that runs faster or slower than real time meets
    the same time-outs.

    Parameters
    ----------
    node
        whose parameter `use_sim_time` counts

    Returns
    -------
    Clock
        the clock
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
