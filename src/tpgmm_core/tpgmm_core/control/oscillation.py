# SPDX-License-Identifier: Apache-2.0
"""`SwingWatch`: notices joints that oscillate with growing amplitude, whatever the cause; time is an argument.

Each joint's velocity is cut into half-swings, from one change of its sign to the next. A swing is an oscillation that
grows, or does not die out, over several of them, is faster than a share of the joint's speed limit, and is not the
motion of the reference. A push decays within two half-swings with a damping ratio of 0.7, and so is none; nor are slow
movements.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled

#: Shares of the speed limit: below the first a joint is at rest, the second counts as a swing, the third is an alarm.
AT_REST, SWINGS, ALARM = 0.01, 0.03, 0.15
#: Half-swings that are slower than this are movements, s.
SLOWEST = 0.5
#: A half-swing of less than this share of the one before has died out.
DIES_OUT = 0.8
#: After so many half-swings that have grown by the factor, or so many that have not died out, it is an alarm.
GROWN_AFTER, GROWTH, ENDLESS_AFTER = 3, 1.5, 6
#: A joint may oscillate as long as the hand moves at no more than this many times the reference's speed, ...
FOLLOWS = 2.0
#: ... which is remembered for this long, s; slower motions (1/s) count as none.
REMEMBERED, NO_MOTION = 0.5, 0.1
#: Joints are calm after speeds below `CALM` of their limits for this long, s.
CALM, CALM_TIME = 0.05, 1.0


@compiled
def count_swings(v: Array, speed_limits: Array, dt: float, counts: bool, swings: Array) -> tuple[int, bool]:
    """Update the swings of n joints by their velocities.

    Parameters
    ----------
    v
        (n,), velocities
    speed_limits
        (n,), of the joints
    dt
        since the last call, s
    counts
        whether this half-swing may count at all
    swings
        (n, 6), for each joint the sign of its half-swing, its peak speed, its time; the peak of the one before; how
        many have not died out; the peak of the first of them

    Returns
    -------
    tuple[int, bool]
        the joint of an alarm, or -1, and whether all joints are calm
    """
    alarm, calm = -1, True
    for i in range(len(v)):
        row, limit, speed = swings[i], speed_limits[i], abs(v[i])
        calm = calm and speed < CALM * limit
        row[2] += dt
        sign = 0.0 if speed < AT_REST * limit else math.copysign(1.0, v[i])
        if sign == 0.0 or sign == row[0]:
            row[1] = max(row[1], speed)
            continue
        peak, before = row[1], row[3]
        if not counts or peak < SWINGS * limit or row[2] > SLOWEST:
            row[4] = 0.0
        elif row[4] == 0.0 or peak < DIES_OUT * before:
            row[4], row[5] = 1.0, peak
        else:
            row[4] += 1.0
            grown = row[4] >= GROWN_AFTER and peak >= GROWTH * row[5]
            if peak >= ALARM * limit and (grown or row[4] >= ENDLESS_AFTER):
                alarm = i
        row[0], row[1], row[3] = sign, speed, peak
        if alarm != i:
            row[2] = 0.0
    return alarm, calm


class SwingWatch:
    """See the module.

    Parameters
    ----------
    speed_limits
        (nv,), of the joints

    Attributes
    ----------
    joint, speed, half_period
        of the last alarm: index, rad/s (m/s), s
    """

    def __init__(self, speed_limits: Array) -> None:
        self._limits = speed_limits
        self._swings = np.zeros((len(speed_limits), 6))
        self.forget()
        self.step(np.zeros(len(speed_limits)), 0.0, 0.0, 0.0)  # compiles

    def forget(self) -> None:
        """Forget all swings."""
        self._swings[:] = 0.0
        self._asked = self._still = 0.0
        self.joint, self.speed, self.half_period = -1, 0.0, 0.0

    @property
    def calm(self) -> bool:
        """Whether no joint has moved much for `CALM_TIME`."""
        return self._still >= CALM_TIME

    def step(self, v: Array, moves: float, asked: float, dt: float) -> bool:
        """Observe velocities.

        Parameters
        ----------
        v
            (nv,), velocities
        moves, asked
            how fast the hand moves, and the reference, 1/s
        dt
            since the last call, s

        Returns
        -------
        bool
            whether a joint oscillates with growing amplitude
        """
        self._asked = max(asked, self._asked * math.exp(-dt / REMEMBERED))
        unasked = moves + NO_MOTION >= FOLLOWS * self._asked
        joint, calm = count_swings(v, self._limits, dt, unasked, self._swings)
        self._still = self._still + dt if calm else 0.0
        if joint < 0:
            return False
        self.joint, self.speed = joint, float(self._swings[joint, 3])
        self.half_period = float(self._swings[joint, 2])
        self._swings[:, 2] = self._swings[:, 4] = 0.0
        return True
