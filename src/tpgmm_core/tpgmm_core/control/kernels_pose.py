# SPDX-License-Identifier: Apache-2.0
"""A pose that is moved towards another one, and kept near the hand's, compiled."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.operational_space import bound_twist
from tpgmm_core.geometry.kernels import compiled, multiply_add
from tpgmm_core.geometry.kernels_rotation import quaternion_difference, turn


@compiled
def pose_difference(base: Array, pose: Array, difference: Array) -> None:
    """Tangent vector from one pose to another, about the fixed axes.

    Parameters
    ----------
    base, pose
        poses (7,), from and to
    difference
        (6,), written: m and rad
    """
    for i in range(3):
        difference[i] = pose[i] - base[i]
    difference[3], difference[4], difference[5] = quaternion_difference(
        pose[3], pose[4], pose[5], pose[6], base[3], base[4], base[5], base[6]
    )


@compiled
def approach(pose: Array, goal: Array, max_linear: float, max_angular: float) -> None:
    """Move a pose in place towards a goal.

    Parameters
    ----------
    pose, goal
        (7,); the pose is changed
    max_linear, max_angular
        largest change, m and rad
    """
    way = np.empty(6)
    pose_difference(pose, goal, way)
    bound_twist(way, max_linear, max_angular)
    for i in range(3):
        pose[i] += way[i]
    turn(pose[3:], way[3], way[4], way[5])


@compiled
def waiting_share(hand: Array, pose: Array, K_V: Array, ratio: Array, max_linear: float, max_angular: float) -> float:
    """Share of its speed with which a pose moves on: 0 where the hand lags by twice what it does at full speed.

    Parameters
    ----------
    hand, pose
        (7,)
    K_V, ratio
        (6, 6): a speed makes the hand lag by (K_V ratio)^-1 times it
    max_linear, max_angular
        largest speeds of the pose, m/s and rad/s

    Returns
    -------
    float
        0 to 1
    """
    lag, turned, asked = np.empty(6), np.zeros(6), np.zeros(6)
    pose_difference(hand, pose, lag)
    multiply_add(ratio, lag, turned)
    multiply_add(K_V, turned, asked)
    linear = math.sqrt(asked[0] ** 2 + asked[1] ** 2 + asked[2] ** 2) / max_linear
    angular = math.sqrt(asked[3] ** 2 + asked[4] ** 2 + asked[5] ** 2) / max_angular
    return min(max(2.0 - max(linear, angular), 0.0), 1.0)


@compiled
def scaled_length(scale: Array, x: Array) -> float:
    """Euclidean length of x (n,), each number of which is multiplied by its scale (n,)."""
    total = 0.0
    for i in range(len(x)):
        total += (scale[i] * x[i]) ** 2
    return math.sqrt(total)


@compiled
def lead(
    pose: Array, hand: Array, max_linear: float, max_angular: float, back_linear: float, back_angular: float
) -> None:
    """Bring a pose in place to at most some distance from the hand's.

    Parameters
    ----------
    pose, hand
        (7,); the pose is changed
    max_linear, max_angular
        largest distance, m and rad
    back_linear, back_angular
        the pose comes back by no more than that, m and rad
    """
    way = np.empty(6)
    pose_difference(hand, pose, way)
    within = way.copy()
    bound_twist(within, max_linear, max_angular)
    back = within - way
    bound_twist(back, back_linear, back_angular)
    for i in range(3):
        pose[i] += back[i]
    turn(pose[3:], back[3], back[4], back[5])
