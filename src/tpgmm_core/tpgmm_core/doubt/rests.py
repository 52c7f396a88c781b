# SPDX-License-Identifier: Apache-2.0
"""Rests before and after a movement that differ from one recording to the next, and hands that stop dead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.geometry import quaternion

STILL_M, STILL_RAD = 0.01, 0.05
"""A hand that stays as near to its first, or last, pose rests."""
LEAST_S, SHARE = 1.0, 0.3
"""Rests that differ by more, and by more than this share of the movement between them, are said."""
FROZEN_S, FROZEN = 0.5, 10
"""Poses that are the same, number by number, for so long, and in so many messages."""
FAST_M, FAST = 0.1, 0.5
"""m/s, and as a share of the usual highest speed: an arm that is so fast does not stop within one message."""


def doubts_of_rests(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Rests at the ends that differ: the same share of the time is then not the same part of the movement.

    Parameters
    ----------
    shown
        demonstrations of one task

    Returns
    -------
    list[Doubt]
        one for the beginning and one for the end, at most
    """
    rests = np.array([_rests(one) for one in shown])
    moving = np.median([one.duration - rest.sum() for one, rest in zip(shown, rests, strict=True)])
    found = []
    for k, where in enumerate(("before", "after")):
        longer = rests[:, k] - rests[:, k].min()
        if longer.max() <= max(LEAST_S, SHARE * moving):
            continue
        names = tuple(
            one.name for one, by in zip(shown, longer.tolist(), strict=True) if by > max(LEAST_S, SHARE * moving)
        )
        text = (
            f"the hand rests for up to {rests[:, k].max():.1f} s {where} it moves, and for {rests[:, k].min():.1f} s "
            "in others: demonstrations are stretched to one duration, so that a rest of one falls on the movement of "
            "another. Cut the rests off: recordings: {takes: {still: 1.0}} in the task file, or from and to in the "
            "edits of the bag"
        )
        found.append(Doubt("duration", names, text))
    return found


def _rests(one: RawDemonstration) -> tuple[float, float]:
    """How long the hand stays at its first and at its last pose, s; a hand that never moves does not rest."""
    begin, end = (_away(one.movement, k) for k in (0, -1))
    if not begin.any() or not end.any():
        return 0.0, 0.0
    last = len(end) - 1 - int(np.argmax(end[::-1]))
    return float(one.times[int(np.argmax(begin))] - one.times[0]), float(one.times[-1] - one.times[last])


def _away(poses: Array, k: int) -> Array:
    way = np.linalg.norm(poses[:, :3] - poses[k, :3], axis=1)
    return np.asarray((way > STILL_M) | (quaternion.angle_between(poses[k, 3:], poses[:, 3:]) > STILL_RAD))


def doubts_of_frozen_hands(one: RawDemonstration) -> list[Doubt]:
    """A hand that stops from full speed within one message, and has the same numbers from then on.

    Parameters
    ----------
    one
        a recording

    Returns
    -------
    list[Doubt]
        one at most
    """
    same = (one.movement[1:] == one.movement[:-1]).all(axis=1)
    if not same.any() or len(same) < 3:
        return []
    speeds = np.linalg.norm(np.diff(one.movement[:, :3], axis=0), axis=1) / np.diff(one.times)
    fast = max(FAST_M, FAST * float(np.quantile(speeds, 0.98)))
    for first in (np.flatnonzero(same[1:] & ~same[:-1]) + 1).tolist():
        moves = np.flatnonzero(~same[first:])
        stop = first + int(moves[0]) if len(moves) else len(same)
        seconds = float(one.times[stop] - one.times[first])
        if seconds > FROZEN_S and stop - first >= FROZEN and speeds[first - 1] > fast:
            text = (
                f"the hand stops at {one.times[first]:.2f} s from {speeds[first - 1]:.2g} m/s within one message, and "
                f"has the same pose in the next {stop - first} messages ({seconds:.2f} s): its publisher stopped "
                "updating it. Record again, or cut it off in the edits of the bag"
            )
            return [Doubt("still", (one.name,), text)]
    return []
