# SPDX-License-Identifier: Apache-2.0
"""`SeenMotion`: how fast a frame was seen to move of late, and so how badly its pose is known while it is not seen."""

from __future__ import annotations

from collections import deque

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.observation.pose_filter import ROUNDING
from tpgmm_core.observation.streams import SECOND

#: A frame's way is measured from one pose to one that is at least so much later, s, and so many ways are remembered:
#: what rested for the time of all these was pushed before, and is at rest now.
PERIOD, REMEMBERED = 0.5, 2
#: Standard deviations of the noise that a way has to exceed.
BEYOND_NOISE = 4.0
#: Standard deviations beyond which a frame that is not seen is simply not known, m and rad.
UNKNOWN = 100.0, 3.0


class SeenMotion:
    """The fastest motion of a frame in its last second in sight.

    Attributes
    ----------
    speed, turn_rate
        m/s and rad/s
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self._last: tuple[int, Array] | None = None
        self._rates: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)
        self.speed = self.turn_rate = 0.0

    def take(self, pose: Array, stamp_ns: int, noise: tuple[float, float]) -> None:
        """See the frame once more.

        Parameters
        ----------
        pose
            (7,), filtered
        stamp_ns
            when, ns
        noise
            standard deviations of its position and of its turn, m and rad
        """
        if self._last is None:
            self._last = stamp_ns, pose
            return
        time = (stamp_ns - self._last[0]) / SECOND
        if time < PERIOD:
            return
        ways = pose_error(pose, self._last[1])
        self._last = stamp_ns, pose
        way, turn = (
            max(0.0, way - BEYOND_NOISE * max(spread, ROUNDING)) / time for way, spread in zip(ways, noise, strict=True)
        )
        self._rates.append((way, turn))
        self.speed, self.turn_rate = np.max(self._rates, axis=0).tolist()

    def covariance(self, covariance: Array | None, unseen: float) -> Array | None:
        """How well the pose is known after a time out of sight: it may have gone on at the fastest speed it had.

        Parameters
        ----------
        covariance
            (6, 6) of the last observation, m² and rad²; None where none is known
        unseen
            time since then, s

        Returns
        -------
        Array or None
            (6, 6); None where nothing makes it uncertain: a frame that was at rest is where it was
        """
        way, turn = (min(rate * unseen, most) for rate, most in zip((self.speed, self.turn_rate), UNKNOWN, strict=True))
        if way == 0.0 and turn == 0.0:
            return covariance
        return (0.0 if covariance is None else covariance) + np.diag(np.repeat([way**2, turn**2], 3))
