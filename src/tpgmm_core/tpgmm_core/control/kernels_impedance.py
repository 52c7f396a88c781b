# SPDX-License-Identifier: Apache-2.0
"""Compiled: the arithmetic of the impedance law; `impedance.py` says what it computes and why."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array, Indices
from tpgmm_core.control.delay_margin import OF_CRITICAL, borne_share, joint_damping
from tpgmm_core.control.kernels_pose import pose_difference
from tpgmm_core.control.operational_space import bound_twist, operational_space
from tpgmm_core.control.torque_limits import fit
from tpgmm_core.geometry.kernels import compiled, is_finite, multiply_add

#: The null space keeps this far away from position limits (rad or m), or this share of the range, ...
STOP_MARGIN, STOP_SHARE = 0.3, 0.15
#: ... with springs of this frequency, rad/s.
STOP_FREQUENCY = 6.0


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

    Joints hold still by their inertia as a whole, since a spring for each by itself makes a chain of joints many times
    as stiff.

    Parameters
    ----------
    arm, others
        indices in the vectors (nv,) of the n joints of the arm, and of the m joints that hold the posture
    M, inverse
        mass matrix (nv, nv) and its inverse
    q, v
        state (nv,)
    posture
        (nv,), held by critically damped springs
    nonlinear
        (nv,), gravity and Coriolis torques
    frequency
        of the springs, rad/s
    damping
        of the arm's joints, N m s/rad
    delay
        of the loop, s; frequency and damping are less where it is too long for them
    feedforward, hold, hand_guiding, given
        (nv,), written: the terms, zero before, and their sum
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
    """Torques of the n joints of an arm that a pose asks for.

    Parameters
    ----------
    arm
        (n,), indices of the arm's joints in the vectors (nv,)
    J_T
        (nv, 6), transposed Jacobian of the hand
    M
        (nv, nv), mass matrix
    q, v
        state (nv,)
    rest
        (n,), posture that the null space goes to
    lower, upper
        position limits (nv,), which the null space keeps away from
    bias_acceleration
        (6,), of the hand without joint accelerations
    pose, twist
        of the hand, (7,) and (6,)
    goal, goal_twist, goal_acceleration
        of the reference, (7,), (6,) and (6,)
    K_P, K_V
        gains (6, 6) of the hand, 1/s² and 1/s
    weight
        scale of all these torques, 0 to 1
    length, max_inertia
        as for `operational_space`, m and kg
    max_linear_acceleration, max_angular_acceleration
        bounds of what is asked of the hand, m/s² and rad/s²
    posture_stiffness, posture_damping
        of the null space, 1/s² and 1/s
    share
        scale of the rates of all feedback, for the delay of the loop, 0 to 1
    effort_limits
        (nv,), N m
    feedforward, given
        (nv,), N m: gravity and Coriolis torques, and all that the motors give besides this law's feedback, which must
        fit into their limits first; the arm's bias is added to both
    feedback, null_space
        (nv,), N m, written: see `LawTorques`
    error, stiffness, damping
        (6,), (6, 6) and (6, 6), written: see `LawTorques`

    Returns
    -------
    int
        0, 1 where weak motors made something saturate, -1 where inertia or state cannot be computed with
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
    pull, brake, off, slip = goal_acceleration.copy(), np.zeros(6), np.empty(6), np.empty(6)
    for i in range(6):
        off[i], slip[i] = share * share * error[i], share * (goal_twist[i] - twist[i])
    multiply_add(K_P, off, pull)
    bound_twist(pull, max_linear_acceleration, max_angular_acceleration)
    multiply_add(K_V, slip, brake)
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
        if not (is_finite(spring[i]) and is_finite(brakes[i]) and is_finite(sofar[i])):
            return -1
    # damping comes first: a pull beyond the motors' strength must not reduce it
    braking = fit(brakes, sofar, limits)
    for i in range(n):
        sofar[i] += braking * brakes[i]
    pulling = fit(spring, sofar, limits)
    for i in range(n):
        feedback[arm[i]] = braking * damper[i] + pulling * spring[i]
        null_space[arm[i]] = braking * free[i]
    for i in range(6):
        for j in range(6):
            stiffness[i, j] = damping[i, j] = 0.0
            for k in range(6):
                stiffness[i, j] += weight * share * share * Lambda[i, k] * K_P[k, j]
                damping[i, j] += weight * share * Lambda[i, k] * K_V[k, j]
    return 1 if min(braking, pulling) < 1.0 else 0
