# SPDX-License-Identifier: Apache-2.0
"""What is left of the difference between two courses, compiled: see `continuity`.

It is kept as an array `left` (4, n): an offset and its rate, and a swing and its rate, each a critically damped spring.
The rate constant of the offset's spring is 1 / time_constant, that of the swing's is 1 / swing_time.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, inlined
from tpgmm_core.geometry.kernels_manifold import difference, longest, move
from tpgmm_core.retrieval.spring import damp, left_of_two


@compiled
def lead(
    points: Array, left: Array, time_constant: float, swing_time: float, seconds: Array, flat: Array, spheres: Array
) -> None:
    """Lead points of a course to where the reference is.

    Parameters
    ----------
    points
        (H, D), changed
    left
        see the module
    time_constant, swing_time
        s
    seconds
        (H,), times of the points from now, s
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    """
    step = np.empty(left.shape[1])
    for h in range(len(points)):
        left_of_two(left[0], left[1], 1.0 / time_constant, left[2], left[3], 1.0 / swing_time, seconds[h], step)
        move(points[h], step, flat, spheres)


@compiled
def advance(left: Array, time_constant: float, swing_time: float, seconds: float) -> float:
    """Let a time pass.

    Parameters
    ----------
    left
        see the module; changed
    time_constant, swing_time
        s
    seconds
        how long, s

    Returns
    -------
    float
        the largest entries of offset and swing, and of their rates times the time constant, added up
    """
    damp(left[0], left[1], 1.0 / time_constant, seconds)
    damp(left[2], left[3], 1.0 / swing_time, seconds)
    total = 0.0
    for j in range(4):
        total += longest(left[j]) * (1.0 if j % 2 == 0 else time_constant)
    return total


@inlined
def _time_of_swing(
    changes: Array, moment: float, share: float, time_constant: float, swing_time: float, left: Array
) -> float:
    """Time constant, s, with which the swing goes no farther than the courses are apart within `time_constant`.

    changes (M, n): by how much the courses are apart at each moment. A swing that is still there counts by its share of
    the velocity.
    """
    M, n = changes.shape
    size, swing, rate = 0.0, 0.0, 0.0
    for i in range(n):
        size += ((changes[1, i] - changes[0, i]) / moment) ** 2
        swing += left[2, i] ** 2
        rate += left[3, i] ** 2
    going_on = math.sqrt(rate) + math.sqrt(swing) / swing_time
    if size + going_on == 0.0 or M == 2:
        return time_constant
    farthest = 0.0
    for m in range(1, M):
        along = 0.0
        for i in range(n):
            along += (changes[1, i] - changes[0, i]) / moment * (changes[m, i] - changes[0, i])
        farthest = max(farthest, abs(along))
    time = min(max(share * farthest / max(size, 1e-300), moment), time_constant)
    speed = math.sqrt(size)
    return (speed * time + going_on * swing_time) / (speed + going_on)


@compiled
def take_over(
    former: Array, means: Array, moments: Array, moment: float, share: float, time_constant: float, swing_time: float,
    flat: Array, spheres: Array, left: Array,
) -> float:  # fmt: skip
    """Continue from the former course: the offset takes the difference of places, the swing that of velocities.

    Parameters
    ----------
    former, means
        (M, D), where the reference would have been, and where the present course is
    moments
        (M or more,), when, s from now; the second one is `moment`
    moment
        time between two places that a velocity is taken from, s
    share
        of the distance between the courses that a swing leads at most
    time_constant, swing_time
        s
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    left
        see the module; changed

    Returns
    -------
    float
        the new time constant of the swing, s
    """
    M, n = len(former), left.shape[1]
    apart, changes, gone = np.empty((M, n)), np.empty((M, n)), np.empty(n)
    for m in range(M):
        difference(former[m], means[m], flat, spheres, apart[m])
        left_of_two(left[0], left[1], 1.0 / time_constant, left[2], left[3], 1.0 / swing_time, moments[m], gone)
        for i in range(n):
            changes[m, i] = apart[m, i] - gone[i]
    time: float = _time_of_swing(changes, moment, share, time_constant, swing_time, left)
    rate, slow = 1.0 / time, 1.0 / time_constant
    for i in range(n):
        left[0, i] = apart[0, i] - left[2, i]
        offset = math.exp(-slow * moment) * (left[0, i] + moment * (left[1, i] + slow * left[0, i]))
        ahead = apart[1, i] - offset
        left[3, i] = (math.exp(rate * moment) * ahead - left[2, i]) / moment - rate * left[2, i]
    return time
