# SPDX-License-Identifier: Apache-2.0
"""Compiled: the arithmetic of the impedance law; `impedance.py` says what it computes and why."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.control.delay_margin import OF_CRITICAL, borne_share, joint_damping
from tpgmm_core.control.operational_space import bound_twist, operational_space
from tpgmm_core.control.torque_limits import fit
from tpgmm_core.geometry.kernels import compiled, quaternion_difference, turn

Indices = NDArray[np.intp]

#: The null space keeps this far away from position limits (rad or m), or this share of the range, ...
STOP_MARGIN, STOP_SHARE = 0.3, 0.15
#: ... with springs of this frequency, rad/s.
STOP_FREQUENCY = 6.0


@compiled
def pose_difference(base: Array, pose: Array, difference: Array) -> None:
    """Tangent vector (6,) from one pose (7,) to another, about the fixed axes."""
    for i in range(3):
        difference[i] = pose[i] - base[i]
    difference[3], difference[4], difference[5] = quaternion_difference(
        pose[3], pose[4], pose[5], pose[6], base[3], base[4], base[5], base[6]
    )


@compiled
def approach(pose: Array, goal: Array, max_linear: float, max_angular: float) -> None:
    """Move a pose (7,) in place towards a goal (7,), by at most max_linear (m) and max_angular (rad)."""
    way = np.empty(6)
    pose_difference(pose, goal, way)
    bound_twist(way, max_linear, max_angular)
    for i in range(3):
        pose[i] += way[i]
    turn(pose[3:], way[3], way[4], way[5])


@compiled
def multiply_add(A: Array, x: Array, y: Array) -> None:
    """Add a product in place: y += A x, for A (n, m), x (m,), y (n,)."""
    for i in range(len(A)):
        total = 0.0
        for j in range(A.shape[1]):
            total += A[i, j] * x[j]
        y[i] += total


@compiled
def waiting_share(hand: Array, pose: Array, K_V: Array, ratio: Array, max_linear: float, max_angular: float) -> float:
    """Share (0 to 1) of its speed with which a pose (7,) moves on: 0 for twice the lag of a hand at full speed.

    K_V, ratio (6, 6) : a speed makes the hand lag by (K_V ratio)^-1 times it; max_linear, max_angular : m/s and rad/s
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
    """Bring a pose (7,) in place to at most max_linear (m) and max_angular (rad) from the hand's.

    back_linear, back_angular : it comes back by no more than that
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


@compiled
def standing_torques(
    arm: Indices,
    others: Indices,
    M: Array,
    inverse: Array,
    q: Array,
    v: Array,
    posture: Array,
    nonlinear: Array,
    frequency: float,
    damping: float,
    delay: float,
    feedforward: Array,
    hold: Array,
    hand_guiding: Array,
    given: Array,
) -> None:
    """Torques that the robot needs whatever the arm does: its weight, joints that hold still, an arm that is damped.

    others (m,) : joints that hold the posture (nv,), with critically damped springs of the frequency (rad/s): by their
        inertia as a whole, since a spring for each by itself makes a chain of joints many times as stiff
    damping : of the arm's joints, N m s/rad
    delay : of the loop, s; frequency and damping are less where it is too long for them
    feedforward, hold, hand_guiding, given (nv,), out : the terms, zero before, and their sum
    """
    for i in range(len(q)):
        feedforward[i] = nonlinear[i]
    mass, damped = np.empty(len(q)), np.zeros(len(q))
    for i in range(len(q)):
        mass[i] = 1.0 / inverse[i, i]
    if damping > 0.0:
        joint_damping(damping, math.inf, mass, inverse, delay, damped)
    frequency *= borne_share(0.5 * OF_CRITICAL / frequency, delay)
    for i in arm:
        hand_guiding[i] = -damped[i] * v[i]
    for i in others:
        for j in others:
            hold[i] += M[i, j] * frequency * (frequency * (posture[j] - q[j]) - 2.0 * v[j])
    for i in range(len(q)):
        given[i] = feedforward[i] + hold[i] + hand_guiding[i]


@compiled
def arm_torques(
    arm: Indices,
    J_T: Array,
    M: Array,
    q: Array,
    v: Array,
    rest: Array,
    lower: Array,
    upper: Array,
    bias_acceleration: Array,
    pose: Array,
    twist: Array,
    goal: Array,
    goal_twist: Array,
    goal_acceleration: Array,
    K_P: Array,
    K_V: Array,
    weight: float,
    length: float,
    max_inertia: float,
    max_linear_acceleration: float,
    max_angular_acceleration: float,
    posture_stiffness: float,
    posture_damping: float,
    share: float,
    effort_limits: Array,
    feedforward: Array,
    given: Array,
    feedback: Array,
    null_space: Array,
    error: Array,
    stiffness: Array,
    damping: Array,
) -> int:
    """Torques of the n joints of an arm that a pose asks for, scaled by the weight (0 to 1).

    arm (n,) : places of the arm's joints in the vectors (nv,); J_T (nv, 6), M (nv, nv), q, v (nv,)
    rest (n,) : posture that the null space goes to; lower, upper (nv,) : position limits, which it keeps away from
    K_P, K_V (6, 6) : of the hand, 1/s^2 and 1/s
    share : of the rates of all feedback, for the delay of the loop
    given (nv,) : what the motors give besides, without which nothing may saturate; the arm's bias is added
    feedforward, feedback, null_space (nv,), error (6,), stiffness, damping (6, 6), out : see `LawTorques`

    Returns 0, 1 where weak motors made something saturate, -1 where the inertia or the state cannot be
    computed with.
    """
    n = len(arm)
    J, M_arm = np.empty((6, n)), np.empty((n, n))
    for i in range(n):
        for j in range(6):
            J[j, i] = J_T[arm[i], j]
        for j in range(n):
            M_arm[i, j] = M[arm[i], arm[j]]
    Lambda, torques, accelerations = np.empty((6, 6)), np.empty((n, 6)), np.empty((6, n))
    if not operational_space(J, M_arm, length, max_inertia, Lambda, torques, accelerations):
        return -1
    pose_difference(pose, goal, error)
    pull, brake = goal_acceleration.copy(), np.zeros(6)
    multiply_add(K_P, share * share * error, pull)
    bound_twist(pull, max_linear_acceleration, max_angular_acceleration)
    multiply_add(K_V, share * (goal_twist - twist), brake)
    posture, wanted = np.empty(n), np.zeros(n)
    for i in range(n):
        k = arm[i]
        posture[i] = share * (share * posture_stiffness * (rest[i] - q[k]) - posture_damping * v[k])
        margin = min(STOP_MARGIN, STOP_SHARE * (upper[k] - lower[k]))
        depth = max(margin - (q[k] - lower[k]), 0.0) - max(margin - (upper[k] - q[k]), 0.0)
        if depth != 0.0:
            depth = min(max(depth, -margin), margin)
            posture[i] += share * STOP_FREQUENCY * (share * STOP_FREQUENCY * depth - 2.0 * abs(depth) / margin * v[k])
    multiply_add(M_arm, posture, wanted)
    # (I - J^T Lambda J M^-1) tau does not accelerate the hand
    of_hand = np.zeros(6)
    multiply_add(accelerations, wanted, of_hand)
    spring, brakes, damper = np.zeros(n), np.empty(n), np.zeros(n)
    free, sofar, limits = np.empty(n), np.empty(n), np.empty(n)
    multiply_add(torques, pull, spring)
    multiply_add(torques, brake, damper)
    for i in range(n):
        bias, shadow = 0.0, 0.0
        for j in range(6):
            bias -= torques[i, j] * bias_acceleration[j]
            shadow += torques[i, j] * of_hand[j]
        spring[i] *= weight
        damper[i] *= weight
        free[i] = weight * (wanted[i] - shadow)
        feedforward[arm[i]] += weight * bias
        given[arm[i]] += weight * bias
        brakes[i] = damper[i] + free[i]
        sofar[i], limits[i] = given[arm[i]], effort_limits[arm[i]]
        if not (math.isfinite(spring[i]) and math.isfinite(brakes[i]) and math.isfinite(sofar[i])):
            return -1
    # damping comes first: a pull beyond the motors' strength must not reduce it
    braking = fit(brakes, sofar, limits)
    for i in range(n):
        sofar[i] += braking * brakes[i]
    pulling = fit(spring, sofar, limits)
    for i in range(n):
        feedback[arm[i]] = braking * damper[i] + pulling * spring[i]
        null_space[arm[i]] = braking * free[i]
    stiffness[:] = weight * share * share * (Lambda @ K_P)
    damping[:] = weight * share * (Lambda @ K_V)
    return 1 if min(braking, pulling) < 1.0 else 0
