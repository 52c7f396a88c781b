# SPDX-License-Identifier: Apache-2.0
"""`TrackedFrame`: what a tracker says of a frame at one moment; and from when on a frame counts as lost."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.settings import check_settings, setting
from tpgmm_core.observation.gate import MotionLimits


class FrameStatus(enum.IntEnum):
    """Statuses as in ``tpgmm_msgs/TaskFrame``."""

    VISIBLE = 0
    HELD = 1
    MISSING = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingConfig:
    """When a frame counts as seen, remembered or lost, s.

    Without an observation for ``visible_timeout`` a frame is HELD: it keeps its confidence for ``hold_time``, loses it
    over ``fade_time``, and then is MISSING. Stamps too far from ROS time are refused: a camera with a wrong clock, a
    queue that was held up, an old bag. Stamps of a clock that is steadily ahead, by a second at most, are corrected.
    """

    visible_timeout: float = setting(
        0.25, 0.001, 60.0, "A frame that was not seen for this long is held at its last pose, s"
    )
    hold_time: float = setting(2.0, 0.0, 3600.0, "How long a held frame keeps its full weight, s")
    fade_time: float = setting(
        0.5, 0.01, 60.0, "Time over which it then loses its weight, and gains it when seen again, s"
    )
    max_future: float = setting(0.05, 0.0, 60.0, "Poses with stamps further in the future are refused, s")
    max_age: float = setting(1.0, 0.001, 3600.0, "Poses with older stamps are refused, s")
    filter_time: float = setting(
        1.0, 0.0, 60.0, "Noisy poses are averaged over this time while the frame is at rest, s; 0: never"
    )
    max_speed: float = setting(
        3.0, 0.0, 1000.0, "A frame that leaps faster than this is refused until it persists, m/s; 0: never"
    )
    max_turn_rate: float = setting(
        6.0, 0.0, 1000.0, "A frame that turns faster than this is refused until it persists, rad/s; 0: never"
    )
    leap_time: float = setting(
        0.3, 0.0, 60.0, "A frame that has leapt and persists for this long is followed, s; 0: at once"
    )

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of its range."""
        check_settings(self)

    @property
    def motion(self) -> MotionLimits:
        """How fast frames move."""
        return MotionLimits(self.max_speed, self.max_turn_rate, self.leap_time)


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """One frame as it is known at one moment.

    Parameters
    ----------
    name
        of the frame
    status
        VISIBLE, HELD or MISSING
    confidence
        0..1, 0 where MISSING
    stamp_ns
        ROS time of the observation that the pose comes from, ns
    pose
        ``[x, y, z, qx, qy, qz, qw]`` in the base frame, m, filtered; None as long as it was never seen
    covariance
        (6, 6) of the pose, m² and rad²: as the source says of that observation, and what the time out of sight adds
        where that is asked for; None where nothing says that it is not known exactly
    stretch
        (3, 3), what its axes do to positions, such as a scaling by its size; None: nothing
    """

    name: str
    status: FrameStatus
    confidence: float
    stamp_ns: int
    pose: NDArray[np.float64] | None
    covariance: NDArray[np.float64] | None = None
    stretch: NDArray[np.float64] | None = None
