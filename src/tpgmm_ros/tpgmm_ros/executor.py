# SPDX-License-Identifier: Apache-2.0
"""One way to run a node: events as they come, a clean end on SIGINT and SIGTERM, pauses of the collector kept out."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tpgmm_ros.parameters import Declared
from tpgmm_ros.rclpy_workarounds import init_rclpy
from tpgmm_ros.scheduling import request_realtime
from tpgmm_ros.timing import guard_clock

REALTIME = Declared(
    "realtime_priority", 0, "Run ahead of ordinary programs (SCHED_FIFO), 1 to 99; 0: as one of them", 0, 99, fixed=True
)


class StopFlag:
    """Set by SIGINT and SIGTERM.

    rclpy's own handlers shut the context down at once, and a controller could no longer publish its last, safe
    command; so they are not installed, and a node gets to end in its own words (``destroy_node``).
    """

    def __init__(self) -> None:
        self.set = False
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.set = True


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """Create a node, serve it until it is told to stop, and end it. Returns the process's exit status.

    A node with a ``loop(executor, stop)`` method is given the thread; any other one answers events.
    A node that cannot start (``ValueError``, ``OSError``, a parameter out of range) ends with status 1 and one line
    that says why.
    """
    init_rclpy(args=args, signal_handler_options=SignalHandlerOptions.NO)
    stop = StopFlag()
    guard_clock()
    try:
        node = make_node()
    except (ValueError, OSError, InvalidParameterValueException, InvalidParameterTypeException) as error:
        print(f"error: {error}", file=sys.stderr)
        rclpy.shutdown()
        return 1
    # The executor's spin() never calls back in the Jazzy wheels; spin_once() in a loop does, and ends with the flag.
    executor = EventsExecutor()
    executor.add_node(node)
    priority = node.declare_parameter(REALTIME.name, REALTIME.default, REALTIME.descriptor()).value
    if priority and (refusal := request_realtime(priority)):
        node.get_logger().warning(f"no real-time priority: {refusal}")
    # What start-up made stays for good; without this, each full collection walks through all of it.
    gc.collect()
    gc.freeze()
    try:
        loop = getattr(node, "loop", None)
        if loop is not None:
            loop(executor, stop)
        else:
            while not stop.set:
                executor.spin_once(timeout_sec=0.1)
    finally:
        executor.remove_node(node)
        node.destroy_node()
        rclpy.shutdown()
    return 0
