# SPDX-License-Identifier: Apache-2.0
"""How well a node keeps up: ticks asked and done, time per step, age of what it used; published once a second.

Once a second too: whether other nodes fit to its topics (`graph_checks`), whether its clock goes, and other warnings:
in the diagnostics and, when new, in the log.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from tpgmm_core.common.text import one_line
from tpgmm_core.observation.streams import RateMeter
from tpgmm_ros.messages.qos import EVENTS
from tpgmm_ros.runtime.graph_checks import graph_problems
from tpgmm_ros.runtime.timing import clock_trouble

#: A longer silence is a pause, not lost ticks.
_PAUSE_NS = 1_000_000_000


class RecentTimes:
    """The last ``size`` values of a quantity, in seconds; recording one is a store."""

    def __init__(self, size: int = 1 << 16) -> None:
        self._values = np.full(size, 0.0)  # zeros would take their memory one by one, later
        self.count = 0
        self.last = 0.0

    def add(self, value: float) -> None:
        """Record a value, s."""
        self._values[self.count % len(self._values)] = self.last = value
        self.count += 1

    def percentile_ms(self, *percents: float) -> list[float]:
        """Percentiles in ms; zeros where nothing was recorded yet."""
        if not self.count:
            return [0.0] * len(percents)
        values = self._values[: min(self.count, len(self._values))]
        return (1e3 * np.percentile(values, percents)).tolist()


class Monitor:
    """Counts and times the steps of one node and publishes them on ``/diagnostics``.

    Parameters
    ----------
    node
        the node
    status
        called once a second, returns (level, message, further key-value pairs)
    rate
        at which the ticks should come that ``tick`` is told of, Hz
    further
        called once a second, returns warnings, which go to the log when they are new
    """

    def __init__(
        self,
        node: Node,
        status: Callable[[], tuple[bytes, str, dict[str, str]]],
        rate: float = 1000.0,
        further: Callable[[], list[str]] = list,
    ) -> None:
        self.asked = 0
        self.done = 0
        self.step = RecentTimes()
        self.age = RecentTimes()
        self._node = node
        self._status, self._further = status, further
        self._last_tick_ns = 0
        self._ticks = 0.0
        self._rate = rate
        self._meter = RateMeter()
        self._warnings: list[str] = []
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", EVENTS)
        # A timer on ROS time would stall with a paused simulation, just when one wants to know.
        self._timer = node.create_timer(1.0, self.publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def tick(self, stamp_ns: int) -> None:
        """A tick that another node gives, by the stamp of its message: ticks that never came count as asked too."""
        self._meter.add(stamp_ns)
        gap = stamp_ns - self._last_tick_ns
        self._last_tick_ns = stamp_ns
        # Summed up, so that ticks that are late and catch up count once.
        self._ticks += 1e-9 * gap * self._rate if 0 < gap < _PAUSE_NS else 1.0
        self.asked = round(self._ticks)

    def publish(self) -> None:
        """Publish what was counted and timed, with the warnings of this moment."""
        level, message, extra = self._status()
        warned, self._warnings = self._warnings, [*self._further(), *graph_problems(self._node)]
        if trouble := clock_trouble(self._node):
            self._warnings.insert(0, trouble)
        for text in self._warnings:
            if text not in warned:
                self._node.get_logger().warning(text)
        if self._warnings:
            level, message = max(level, DiagnosticStatus.WARN), "; ".join([message, *self._warnings])
        step_p50, step_p99, step_max = self.step.percentile_ms(50, 99, 100)
        period = self._meter.measured()
        age_p50, age_p99 = self.age.percentile_ms(50, 99)
        values = {
            "ticks_asked": str(self.asked),
            "ticks_done": str(self.done),
            "step_p50_ms": f"{step_p50:.4f}",
            "step_p99_ms": f"{step_p99:.4f}",
            "step_max_ms": f"{step_max:.4f}",
            "age_p50_ms": f"{age_p50:.4f}",
            "age_p99_ms": f"{age_p99:.4f}",
            **({} if period is None else {"tick_rate_hz": f"{1.0 / period:.1f}"}),
            **extra,
        }
        array = DiagnosticArray()
        array.header.stamp = self._node.get_clock().now().to_msg()
        array.status = [
            DiagnosticStatus(
                level=level,
                name=self._node.get_fully_qualified_name().lstrip("/"),
                message=one_line(message),
                hardware_id="",
                values=[KeyValue(key=one_line(key, 200), value=one_line(value)) for key, value in values.items()],
            )
        ]
        self._publisher.publish(array)
