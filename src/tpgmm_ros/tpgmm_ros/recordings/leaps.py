# SPDX-License-Identifier: Apache-2.0
"""Poses of a bag that one thing cannot have gone through: left out, or the bag is refused with the likely cause."""

from pathlib import Path

import numpy as np

from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.gate import MotionLimits
from tpgmm_core.observation.plausible_poses import plausible_poses
from tpgmm_ros.recordings.bag_messages import MOST_BAD, BagError

STEADY = 0.8
"""Of what goes straight on, two steps together are as long as each for itself; of what leaps, far less."""


def without_leaps(
    path: Path, topic: str, times: Nanoseconds, poses: Array, limits: MotionLimits
) -> tuple[Nanoseconds, Array, list[str]]:
    """Leave out what one thing cannot have gone through.

    Parameters
    ----------
    path, topic
        where the poses are from, for errors
    times
        (T,), ns, increasing
    poses
        (T, 7), or with more columns, which stay beside them
    limits
        how fast it can move

    Returns
    -------
    tuple[Nanoseconds, Array, list[str]]
        the times and poses that are kept, and notes

    Raises
    ------
    BagError
        hardly any piece of them follows from another one.
    """
    found = plausible_poses(poses[:, :7], times, limits)
    left, notes = len(poses) - int(np.count_nonzero(found.kept)), []
    if left:
        first = (times[int(np.argmin(found.kept))] - times[0]) * 1e-9
        what = (
            f"leap by up to {found.way:.3f} m and {np.degrees(found.turn):.0f} deg, faster than {limits.speed:g} m/s "
            f"and {limits.turn_rate:g} rad/s, first {first:.2f} s after the start"
        )
        if left >= MOST_BAD * len(poses):
            seconds = 1e-9 * np.diff(times)
            speed = _steady([np.linalg.norm(poses[k:, :3] - poses[:-k, :3], axis=1) for k in (1, 2)], seconds)
            if speed > limits.speed:
                raise BagError(
                    path,
                    f"{topic} goes on smoothly, but at {speed:.3g} m/s, where {limits.speed:g} m/s is the most: its "
                    "positions are not in m (but in inches, centimetres or millimetres), or its times are not in s. "
                    "Publish m, or allow more by max_speed in the part tracking of the task file",
                )
            rate = _steady([quaternion.angle_between(poses[:-k, 3:7], poses[k:, 3:7]) for k in (1, 2)], seconds)
            if rate > limits.turn_rate:
                raise BagError(
                    path,
                    f"{topic} turns smoothly, but at {rate:.3g} rad/s, where {limits.turn_rate:g} rad/s is the "
                    "most: its angles were in degrees and taken for rad, or its times are not in s. Correct what "
                    "writes them, or allow more by max_turn_rate in the part tracking of the task file",
                )
            raise BagError(
                path,
                f"{topic}: {left} of {len(poses)} poses {what}; what sees it mixes things up, or two things "
                "are on one topic. Record it again, or allow more by max_speed and max_turn_rate in the part "
                "tracking of the task file",
            )
        notes.append(f"{topic}: {left} of {len(poses)} poses {what}: left out")
    if found.followed:
        at = ", ".join(f"{time:.2f}" for time in found.followed[:5])
        notes.append(f"{topic} leaps and stays there, {len(found.followed)} times, at {at} s: followed")
    return times[found.kept], poses[found.kept], notes


def _steady(ways: list[Array], seconds: Array) -> float:
    """Median speed of what goes on in its direction, by its ways over one step (T - 1) and two; 0 of what leaps."""
    one, two = ways
    if len(two) < 2 or two.sum() < STEADY * (one[1:] + one[:-1]).sum():
        return 0.0
    return float(np.median(one / seconds))
