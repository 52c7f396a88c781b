# SPDX-License-Identifier: Apache-2.0
"""Clocks that jump, for a frame_tracker on the time of a bag that is played."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from faults.table import fault
from ros_graph import ALL_LATCHED, SECOND, TASK_FILE, Inbox, ros_arguments
from ros_testing import StartProcess, spin_until
from tpgmm_msgs.msg import TaskFrame, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import EVENTS, STREAM

PLACE = np.array([0.6, 0.4, 0.1, 0.0, 0.0, 0.0, 1.0])
STEP_NS = 20_000_000
#: No status at all: no task parameters have come since the last ones were forgotten.
NOTHING_YET = 255


class BagBench:
    """Plays `/clock` and the poses of one object to a frame_tracker that runs on simulated time."""

    name: ClassVar[str] = "bag"
    realtime: ClassVar[bool] = False

    def __init__(self, node: Node, start: StartProcess) -> None:
        self.node, self.time_ns = node, 100 * SECOND
        self.process = start("frame_tracker", *ros_arguments(task_file=TASK_FILE, use_sim_time=True))
        self.frames = Inbox(node, TaskParameters, "task_parameters", ALL_LATCHED)
        self._clock = node.create_publisher(Clock, "/clock", EVENTS)
        self._poses = node.create_publisher(PoseStamped, "object/pose", STREAM)

    @classmethod
    def open(cls, node: Node, start: StartProcess, directory: Path) -> Self:
        return cls(node, start)

    def prepare(self) -> None:
        self.play_until(lambda: self.object().status == TaskFrame.VISIBLE and self.object().confidence == 1.0, "seen")
        self.frames.clear()

    def settle(self) -> str:
        self.play_until(lambda: self.object().status == TaskFrame.VISIBLE and self.object().confidence == 1.0, "seen")
        assert np.allclose(self.object().b[:3], PLACE[:3])
        return "back: VISIBLE with full confidence"

    def object(self) -> TaskFrame:
        """What is known of the object at present."""
        if self.frames.last is None:
            return TaskFrame(status=NOTHING_YET)
        return next(frame for frame in self.frames.last.frames if frame.name == "object")

    def play_until(self, condition: Callable[[], Any], what: str, place: np.ndarray | None = PLACE) -> None:
        """Play the bag, with the object at a place or unseen, until a condition holds."""

        def played() -> bool:
            self.time_ns += STEP_NS
            self._clock.publish(Clock(clock=conversions.time_from_ns(self.time_ns)))
            if place is not None:
                # as of a moment ago: pose and clock race each other
                self._poses.publish(conversions.pose_stamped(place, self.time_ns - STEP_NS, "base"))
            return bool(condition())

        spin_until(self.node, played, message=what, processes=(self.process,))


@fault(
    BagBench,
    "a looped bag: time jumps back by 50 s",
    "all observations are forgotten, with a warning; the first poses of the new round count",
)
def looped(bench: BagBench) -> str:
    already = bench.process.output.count("time jumped backwards")
    bench.time_ns -= 50 * SECOND
    bench.play_until(lambda: bench.object().status == TaskFrame.MISSING, "MISSING", None)
    assert bench.process.output.count("time jumped backwards") > already
    return "MISSING, 'time jumped backwards: all observations are forgotten'"


@fault(
    BagBench,
    "time leaps forward by an hour",
    "what was seen before is too old: not VISIBLE any more; the next poses count",
)
def leaps_forward(bench: BagBench) -> str:
    bench.time_ns += 3600 * SECOND
    bench.play_until(lambda: bench.object().status in (TaskFrame.HELD, TaskFrame.MISSING), "HELD", None)
    return f"{'HELD' if bench.object().status == TaskFrame.HELD else 'MISSING'} with the next task parameters"
