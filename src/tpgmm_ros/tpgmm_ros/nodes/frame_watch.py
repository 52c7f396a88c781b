# SPDX-License-Identifier: Apache-2.0
"""`FrameWatch`: which frames of a task are seen at the moment, and how often, judged as the frame tracker judges."""

from __future__ import annotations

import time
from dataclasses import dataclass

from rclpy.node import Node

from tpgmm_core.common.types import Array
from tpgmm_core.observation.poses import Observation
from tpgmm_core.observation.streams import ClockWatch
from tpgmm_core.observation.tracked import FrameStatus, TrackingConfig
from tpgmm_core.observation.tracking import FrameTracker
from tpgmm_ros.nodes.frame_sources import FrameSources
from tpgmm_ros.task.task_file import Task


@dataclass(frozen=True, slots=True)
class Seen:
    """How a frame is seen at one moment.

    Attributes
    ----------
    name
        of the frame
    missing
        it was never seen, or not for long
    rate
        of its observations, Hz; None while too few have come, and for frames that never move
    count
        observations so far that could be used
    trouble
        why others could not, in words; empty where all could
    """

    name: str
    missing: bool
    rate: float | None
    count: int
    trouble: str = ""


class FrameWatch:
    """Watches the observed frames of a task on their topics.

    Parameters
    ----------
    node
        that subscribes
    task
        names the frames and their sources

    Raises
    ------
    ModuleNotFoundError
        the messages of a source are not installed.
    """

    def __init__(self, node: Node, task: Task) -> None:
        self._node = node
        self._tracker = FrameTracker(task.sources, fixed={}, config=TrackingConfig(**task.tracking))
        self._counts = dict.fromkeys(task.sources, 0)
        self._clock_watch = ClockWatch()
        self._sources = FrameSources(
            node, task.sources, task.base_frame, self._observe, self._tracker.refuse, self._fix
        )

    def frames(self) -> list[Seen]:
        """All observed frames as they are seen now."""
        now = time.monotonic_ns()
        if self._clock_watch.was_set_back(self._node.get_clock().now().nanoseconds):
            self._tracker.forget()
            self._sources.forget()
        status = {frame.name: frame.status for frame in self._tracker.update(now, self._sources.kept)}
        health, unknown = self._tracker.health(now), self._sources.unknown()
        found = []
        for name, count in self._counts.items():
            missing = status[name] is FrameStatus.MISSING
            rate = health[name].rate if name in health and status[name] is FrameStatus.VISIBLE else None
            refused = health[name].trouble if name in health else ""
            trouble = (refused or unknown.get(name, "")) if missing else ""
            found.append(Seen(name, missing, rate, count, trouble))
        return found

    def _observe(self, name: str, observation: Observation) -> None:
        now_ns = self._node.get_clock().now().nanoseconds
        steady_ns, lasts = time.monotonic_ns(), observation.lasts
        stamp_ns, pose, covariance = observation.stamp_ns, observation.pose, observation.covariance
        if self._tracker.observe(name, pose, stamp_ns, now_ns, steady_ns, covariance, lasts=lasts) is None:
            self._counts[name] += 1

    def _fix(self, name: str, pose: Array) -> None:
        if self._tracker.fix(name, pose) is None:
            self._counts[name] += 1
