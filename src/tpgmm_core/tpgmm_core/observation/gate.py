# SPDX-License-Identifier: Apache-2.0
"""Poses that a frame cannot have come to: leaps, flips of a tag, identities that were swapped.

From one observation to the next a thing moves and turns by no more than a speed allows, and the noise of what sees it.
Where it is seen all the time, at two places by turns, the time since it was at one of them allows nothing.
What leaps farther is refused, until it persists: things are moved by hand while nobody looks, and then stay. With
hindsight more can be said of a recording: `plausible_poses`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from tpgmm_core.common.types import Array
from tpgmm_core.observation.streams import SECOND, RateMeter

#: What noise may add to the way and the turn between two observations, m and rad.
NOISE_WAY, NOISE_TURN = 0.03, 0.2
#: A leap persists only if it was seen so often; a turn on the spot, which tags make and hands do not, more often.
FEWEST, FEWEST_FLIPS = 3, 10
#: A turn on the spot has to persist for so many times the time of a leap.
FLIP_PATIENCE = 3.0
#: What was followed is given up where the time at one other place exceeds that at its own by so many times the
#: patience: the first pose that came may have been a flipped one.
MAJORITY = 3.0
#: Messages that come in bursts: the time between two counts as their mean period, of so many, up to this, s.
PERIODS, LONGEST_PERIOD = 8, 0.1


class Leap(NamedTuple):
    """From where an observation was expected to where it is.

    Parameters
    ----------
    way
        m
    turn
        rad
    time
        since the last observation that was used, s
    is_flip
        whether it turned on the spot
    """

    way: float
    turn: float
    time: float
    is_flip: bool


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """How fast frames move.

    Parameters
    ----------
    speed
        m/s; 0: any
    turn_rate
        rad/s; 0: any
    leap_time
        what leaps and persists for this long is followed, s; 0: all is followed at once
    """

    speed: float = 3.0
    turn_rate: float = 6.0
    leap_time: float = 0.3

    @property
    def hold_anything(self) -> bool:
        """Whether there is anything that these refuse."""
        return self.leap_time > 0.0 and (self.speed > 0.0 or self.turn_rate > 0.0)

    def way[TimeT: (float, Array)](self, time: TimeT) -> TimeT:
        """The longest way in a time, s → m."""
        return time * self.speed + NOISE_WAY if self.speed > 0.0 else time + math.inf

    def turn[TimeT: (float, Array)](self, time: TimeT) -> TimeT:
        """The largest turn in a time, s → rad."""
        return time * self.turn_rate + NOISE_TURN if self.turn_rate > 0.0 else time + math.inf


@dataclass(slots=True)
class _Seen:
    pose: list[float]
    stamp_ns: int


@dataclass(slots=True)
class _Elsewhere(_Seen):
    """Where it leapt to, if it did."""

    leap: Leap
    since_ns: int
    times: int = 1


@dataclass(slots=True)
class _Rival(_Seen):
    """Where it is seen too, by turns."""

    is_flip: bool
    excess: float = 0.0
    """Time there less the time where it is followed, s."""


class LeapGate:
    """Judges the observations of one frame, one after the other; time is their stamps.

    Parameters
    ----------
    limits
        how fast the frame can move
    """

    def __init__(self, limits: MotionLimits) -> None:
        self.limits = limits
        self._rate = RateMeter()
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self._last: _Seen | None = None
        self._other: _Elsewhere | None = None
        self._rival: _Rival | None = None
        self._rate.forget()
        self._stamps: deque[int] = deque(maxlen=PERIODS + 1)

    @property
    def period(self) -> float | None:
        """Seconds from one observation to the next; None while too few have come."""
        return self._rate.measured()

    def judge(self, pose: Array, stamp_ns: int) -> Leap | None:
        """Whether an observation can be followed.

        Parameters
        ----------
        pose
            shape (7,), with a unit quaternion
        stamp_ns
            when it was seen, ns

        Returns
        -------
        Leap or None
            None: the frame is followed there. Else how far it would have leapt
        """
        self._rate.add(stamp_ns)
        since = min(LONGEST_PERIOD, (stamp_ns - self._stamps[-1]) / SECOND) if self._stamps else 0.0
        self._stamps.append(stamp_ns)
        seen, last, other = pose.tolist(), self._last, self._other
        if last is not None and self.limits.hold_anything:
            leap = self._leap(last, seen, stamp_ns)
            if other is not None and self._goes_on(other, last, seen, stamp_ns):
                leap = leap or other.leap
            if leap is not None:
                outweighs = self._outweighs(leap, seen, stamp_ns, since)
                if not (self._persists(leap, seen, stamp_ns) or outweighs):
                    return leap
                self._rival = None
        self._last, self._other = _Seen(seen, stamp_ns), None
        if self._rival is not None:
            self._rival.excess -= since
            if self._rival.excess < 0.0:
                self._rival = None
        return None

    def _outweighs(self, leap: Leap, seen: list[float], stamp_ns: int, since: float) -> bool:
        """Whether it is seen there so much more than where it is followed that this is the wrong place."""
        rival = self._rival
        if rival is None:
            self._rival = _Rival(seen, stamp_ns, leap.is_flip, since)
            return False
        if self._leap(rival, seen, stamp_ns) is not None:
            return False
        self._rival = _Rival(seen, stamp_ns, rival.is_flip, rival.excess + since)
        patience = FLIP_PATIENCE if rival.is_flip else 1.0
        return self._rival.excess >= MAJORITY * patience * self.limits.leap_time

    def _goes_on(self, other: _Elsewhere, last: _Seen, seen: list[float], stamp_ns: int) -> bool:
        """Whether this is nearer to where it leapt than to where it was before."""
        if self._leap(other, seen, stamp_ns) is not None:
            return False
        limits = self.limits
        there, here = (_apart(was.pose, seen) for was in (other, last))
        scale = limits.way(LONGEST_PERIOD), limits.turn(LONGEST_PERIOD)
        return there[0] / scale[0] + there[1] / scale[1] < here[0] / scale[0] + here[1] / scale[1]

    def _persists(self, leap: Leap, seen: list[float], stamp_ns: int) -> bool:
        other = self._other
        if other is None or self._leap(other, seen, stamp_ns) is not None:
            self._other = _Elsewhere(seen, stamp_ns, leap, stamp_ns)
            return False
        self._other = other = _Elsewhere(seen, stamp_ns, other.leap, other.since_ns, other.times + 1)
        patience, fewest = (FLIP_PATIENCE, FEWEST_FLIPS) if other.leap.is_flip else (1.0, FEWEST)
        return other.times >= fewest and stamp_ns - other.since_ns >= patience * self.limits.leap_time * SECOND

    def _leap(self, last: _Seen, seen: list[float], stamp_ns: int) -> Leap | None:
        limits = self.limits
        way, turn = _apart(last.pose, seen)
        time = max(0.0, (stamp_ns - last.stamp_ns) / SECOND)
        if way <= limits.way(time) and turn <= limits.turn(time):
            return None
        mean = (self._stamps[-1] - self._stamps[0]) / SECOND / max(1, len(self._stamps) - 1)
        time = max(time, min(LONGEST_PERIOD, mean))
        if way <= limits.way(time) and turn <= limits.turn(time):
            return None
        return Leap(way, turn, time, way <= limits.way(time))


def _apart(a: list[float], b: list[float]) -> tuple[float, float]:
    """Way and turn between two poses, m and rad."""
    cosine = abs(a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6])
    return math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]), 2.0 * math.acos(min(1.0, cosine))
