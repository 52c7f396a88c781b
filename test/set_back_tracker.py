# SPDX-License-Identifier: Apache-2.0
"""frame_tracker on a machine whose clock is set back: by an hour, as soon as somebody asks for it."""

from __future__ import annotations

import sys
from typing import Any

from rclpy.clock import Clock
from rclpy.duration import Duration
from rclpy.time import Time
from std_srvs.srv import Trigger

from tpgmm_ros.nodes.frame_tracker import FrameTrackerNode
from tpgmm_ros.runtime.executor import run

BACK = Duration(seconds=3600)


class SetBackClock:
    """A clock that is `back` behind."""

    def __init__(self, clock: Clock) -> None:
        self._clock, self.back = clock, Duration()

    def now(self) -> Time:
        now = self._clock.now()
        return Time(nanoseconds=now.nanoseconds - self.back.nanoseconds, clock_type=now.clock_type)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._clock, name)


class SetBackTracker(FrameTrackerNode):
    """As it is, but for its clock."""

    def __init__(self) -> None:
        super().__init__()
        self.create_service(Trigger, "set_back", self._set_back)

    def get_clock(self) -> Any:
        if not hasattr(self, "its_clock"):
            self.its_clock = SetBackClock(super().get_clock())
        return self.its_clock

    def _set_back(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.its_clock.back = BACK
        response.success = True
        return response


if __name__ == "__main__":
    sys.exit(run(SetBackTracker))
