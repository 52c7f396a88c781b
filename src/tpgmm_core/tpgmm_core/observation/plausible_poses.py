# SPDX-License-Identifier: Apache-2.0
"""Which poses of a recorded frame one thing can have gone through: what `gate` judges live, with hindsight.

What persists is followed from its first pose, except for flips, turns on the spot that no hand makes, of which the
longer side is right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.gate import FEWEST, LONGEST_PERIOD, NOISE_WAY, PERIODS, MotionLimits
from tpgmm_core.observation.streams import SECOND

#: Pieces between leaps of a recording that are tried as what came before another one.
LOOK_BACK = 64


class PlausiblePoses(NamedTuple):
    """What of a recorded frame one thing can have gone through.

    Parameters
    ----------
    kept
        (T,) poses that are used
    way, turn
        of the farthest leap to a pose that is not, m and rad
    followed
        times of the leaps that persisted and are followed, s from the first pose
    """

    kept: NDArray[np.bool_]
    way: float
    turn: float
    followed: tuple[float, ...]


def plausible_poses(poses: Array, stamps_ns: NDArray[np.int64], limits: MotionLimits) -> PlausiblePoses:
    """Most poses that one thing can have gone through.

    The recording is cut where it leaps. Of the pieces, a sequence is taken with most poses in it, in which each piece
    can be reached from the one before: at the speed of the limits, or since both persist; but not by a flip.

    Parameters
    ----------
    poses
        (T, 7), with unit quaternions
    stamps_ns
        (T,), ns, increasing
    limits
        how fast the frame can move

    Returns
    -------
    PlausiblePoses
        which poses are kept, and what was found
    """
    T = len(poses)
    everything = PlausiblePoses(np.ones(T, bool), 0.0, 0.0, ())
    if T < 2 or not limits.hold_anything:
        return everything
    seconds = (stamps_ns - stamps_ns[0]) / SECOND
    reach = _Reach(poses, seconds, limits)
    possible, _ = reach.between(np.arange(T - 1), np.arange(1, T), np.diff(seconds))
    if possible.all():
        return everything
    cuts = np.flatnonzero(~possible) + 1
    starts, ends = np.concatenate([[0], cuts]), np.concatenate([cuts, [T]]) - 1
    counts = ends - starts + 1
    persists = (seconds[ends] - seconds[starts] >= limits.leap_time) & (counts >= FEWEST)
    best, before = counts.copy(), np.full(len(counts), -1)
    for i in range(1, len(counts)):
        earlier = np.arange(max(0, i - LOOK_BACK), i)
        unseen = reach.longest_gaps(ends[earlier], int(starts[i]))
        possible, is_flip = reach.between(ends[earlier], np.full(len(earlier), starts[i]), unseen)
        possible |= persists[i] & persists[earlier] & ~is_flip
        if possible.any():
            # of equal ones the nearest
            j = int(earlier[possible][::-1][np.argmax(best[earlier[possible]][::-1])])
            best[i], before[i] = counts[i] + best[j], j
    chain = [int(np.argmax(best))]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    chain.reverse()
    kept = np.zeros(T, bool)
    for i in chain:
        kept[starts[i] : ends[i] + 1] = True
    way, turn = reach.farthest(kept)
    pieces = np.array(chain)
    last, first = ends[pieces[:-1]], starts[pieces[1:]]
    possible, _ = reach.between(last, first, seconds[first] - seconds[last])
    return PlausiblePoses(kept, way, turn, tuple(seconds[first[~possible]].tolist()))


class _Reach:
    """What poses of a recording can be reached from what others."""

    def __init__(self, poses: Array, seconds: Array, limits: MotionLimits) -> None:
        self._poses, self._seconds, self._limits = poses, seconds, limits
        before = np.maximum(np.arange(len(seconds)) - PERIODS, 0)
        mean = (seconds - seconds[before]) / np.maximum(np.arange(len(seconds)) - before, 1)
        self._shortest = np.minimum(mean, LONGEST_PERIOD)

    def _apart(self, i: NDArray[np.intp], j: NDArray[np.intp]) -> tuple[Array, Array]:
        way = np.linalg.norm(self._poses[j, :3] - self._poses[i, :3], axis=1)
        return way, quaternion.angle_between(self._poses[j, 3:], self._poses[i, 3:])

    def longest_gaps(self, i: NDArray[np.intp], j: int) -> Array:
        """The longest time without any observation between each pose i, ascending, and pose j, s."""
        gaps = np.diff(self._seconds[i[0] : j + 1])
        return np.maximum.accumulate(gaps[::-1])[::-1][i - i[0]]

    def between(
        self, i: NDArray[np.intp], j: NDArray[np.intp], unseen: Array
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether each pose j can be reached from pose i, and whether it turned on the spot.

        What is between them counts as something else: the thing may have moved meanwhile, but if it has only turned, it
        did so within a time in which it was not seen, `unseen`, s.
        """
        way, turn = self._apart(i, j)
        time, limits = np.maximum(self._seconds[j] - self._seconds[i], self._shortest[j]), self._limits
        on_the_spot = way <= NOISE_WAY
        turning = np.where(on_the_spot, np.maximum(unseen, self._shortest[j]), time)
        near, level = way <= limits.way(time), turn <= limits.turn(turning)
        return near & level, near & ~level

    def farthest(self, kept: NDArray[np.bool_]) -> tuple[float, float]:
        """How far the poses that are not kept are from the kept one before them, at most; else from the next one."""
        at = np.flatnonzero(kept)
        away = np.flatnonzero(~kept)
        if not len(away):
            return 0.0, 0.0
        way, turn = self._apart(at[np.maximum(np.searchsorted(at, away) - 1, 0)], away)
        return float(way.max()), float(turn.max())
