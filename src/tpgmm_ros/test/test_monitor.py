# SPDX-License-Identifier: Apache-2.0
"""Ticks asked and done, percentiles, and what a node publishes about itself."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from ros_testing import spin_until
from tpgmm_ros.runtime.monitor import Monitor, Samples

MS = 1_000_000


def monitor_of(node: Node) -> Monitor:
    return Monitor(node, lambda: (DiagnosticStatus.WARN, "in words", {"more": "7"}))


def test_percentiles_are_in_ms_and_zero_without_samples() -> None:
    samples = Samples()
    assert samples.percentile_ms(50, 99) == [0.0, 0.0]
    for i in range(101):
        samples.add(1e-3 * i)
    assert samples.percentile_ms(0, 50, 100) == pytest.approx([0.0, 50.0, 100.0])


def test_only_the_last_samples_count() -> None:
    samples = Samples(size=10)
    for value in (*[1.0] * 100, *[2.0] * 10):
        samples.add(value)
    assert samples.count == 110 and samples.percentile_ms(0, 100) == [2000.0, 2000.0]


def test_ticks_that_never_came_count_as_asked(ros_node: Node) -> None:
    monitor = monitor_of(ros_node)
    stamps = [ms for ms in range(1000) if ms not in (500, 501, 700)]
    for ms in stamps:
        monitor.tick((10_000 + ms) * MS)
    assert len(stamps) == 997 and monitor.asked == 1000


def test_jitter_of_stamps_is_no_lost_tick(ros_node: Node) -> None:
    monitor = monitor_of(ros_node)
    for i in range(1000):
        monitor.tick((10_000 + i) * MS + (i % 3) * 200_000)
    assert monitor.asked == 1000


def test_a_pause_and_a_clock_that_steps_back_are_no_lost_ticks(ros_node: Node) -> None:
    monitor = monitor_of(ros_node)
    for begin in (10_000, 60_000, 1_000):
        for ms in range(100):
            monitor.tick((begin + ms) * MS)
    assert monitor.asked == 300


def test_once_a_second_the_node_says_how_it_is_on_diagnostics(ros_node: Node) -> None:
    received: list[DiagnosticArray] = []
    ros_node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    monitor = monitor_of(ros_node)
    monitor.asked, monitor.done = 5, 4
    monitor.step.add(0.002)
    spin_until(ros_node, lambda: received, message="diagnostics")
    (status,) = received[0].status
    assert (status.level, status.name, status.message) == (DiagnosticStatus.WARN, "test", "in words")
    values = {item.key: item.value for item in status.values}
    assert values["ticks_asked"] == "5" and values["ticks_done"] == "4" and values["more"] == "7"
    assert float(values["step_p50_ms"]) == pytest.approx(2.0)
