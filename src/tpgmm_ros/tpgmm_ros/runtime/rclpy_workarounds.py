# SPDX-License-Identifier: Apache-2.0
"""What has to be set otherwise in rclpy than it comes; for which version, and why."""

from __future__ import annotations

from typing import Any

import rclpy
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock as ClockMessage


def init_rclpy(**options: Any) -> None:
    """`rclpy.init` for every process that has an `EventsExecutor`: see the functions below."""
    without_status_events()
    guard_clock()
    rclpy.init(**options)


def without_status_events() -> None:
    """From now on, publishers and subscriptions watch no status event of the middleware that nobody asked for.

    By default rclpy watches each of them for partners with an incompatible quality of service, to log a warning. With
    an executor that is called on events, rmw_fastrtps then holds a lock of its own while it asks Fast DDS for the
    status, and Fast DDS holds one of its own while it tells rmw_fastrtps of a new one: where both happen at once, the
    node stands still for ever, with all of its topics. (ros2/rmw_fastrtps, pull request 890, of June 2026;
    rmw_fastrtps 8.4.3 of the Jazzy wheels is older.) Without such an event there is nothing to ask for. `peers` says
    who cannot be heard, from the graph, and with the name of the other node.
    """
    for callbacks in (PublisherEventCallbacks, SubscriptionEventCallbacks):
        defaults = callbacks.__init__.__kwdefaults__
        assert defaults is not None
        defaults["use_default_callbacks"] = False


def guard_clock() -> None:
    """From now on a time on ``/clock`` that is none is refused: rclpy would raise in its callback and end the node."""
    take = TimeSource.clock_callback
    if take.__name__ == "guarded":  # once for each process
        return

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
