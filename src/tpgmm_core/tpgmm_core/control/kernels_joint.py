# SPDX-License-Identifier: Apache-2.0
"""Compiled: the arithmetic of the joint-space laws; `joint_impedance.py` says what it computes and why."""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array, Indices
from tpgmm_core.control.torque_limits import clamp
from tpgmm_core.geometry.kernels import cholesky, compiled, invert_lower, is_finite


@compiled
def inertia_factor(joints: Indices, M: Array, L: Array, F: Array) -> bool:
    """Factor the inertia of n joints, L L^T.

    Parameters
    ----------
    joints
        (n,), indices in the vectors (nv,)
    M
        (nv, nv), mass matrix
    L, F
        (n, n), written, zero before: the Cholesky factor and F = L^-1

    Returns
    -------
    bool
        False where the inertia is not positive definite
    """
    n = len(joints)
    part = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            part[i, j] = M[joints[i], joints[j]]
    if not cholesky(part, n, L):
        return False
    invert_lower(L, n, F)
    for i in range(n):
        L[i, i] = 1.0 / L[i, i]  # the kernel keeps reciprocals
    return True


@compiled
def precision_damping(
    L: Array, F: Array, precision: Array, control_cost: float, min_stiffness: float, max_stiffness: float, D: Array
) -> float:
    """Damping D = L (2 S)^(1/2) L^T with S² = F Q F^T / r.

    Parameters
    ----------
    L, F
        (n, n), of `inertia_factor`
    precision
        (n, n), Q
    control_cost
        r
    min_stiffness, max_stiffness
        bounds of the eigenvalues of S, 1/s²
    D
        (n, n), written

    Returns
    -------
    float
        the largest eigenvalue of K_V = F D F^T, 1/s; -1 where S cannot be computed with
    """
    n = len(L)
    S = F @ precision @ F.T
    for i in range(n):
        for j in range(i + 1):
            if not is_finite(S[i, j]):
                return -1.0
            S[i, j] = S[j, i] = 0.5 * (S[i, j] + S[j, i])
    values, vectors = np.linalg.eigh(S)
    rate = 0.0
    for k in range(n):
        frequency = np.sqrt(max(values[k], 0.0) / control_cost)
        rate = np.sqrt(2.0 * min(max(frequency, min_stiffness), max_stiffness))
        root = np.sqrt(rate)  # since the product with its own transpose follows
        for i in range(n):
            vectors[i, k] *= root
    modes = L @ vectors
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(n):
                total += modes[i, k] * modes[j, k]
            D[i, j] = D[j, i] = total
    return rate  # eigenvalues come in ascending order


@compiled
def joint_torques(
    joints: Indices,
    L: Array,
    F: Array,
    error: Array,
    velocities: Array,
    v: Array,
    D: Array,
    ratio: Array,
    push: Array,
    weight: float,
    share: float,
    effort_limits: Array,
    given: Array,
    feedback: Array,
    stiffness: Array,
    damping: Array,
) -> int:
    """Torques that the reference of n joints asks for.

    Parameters
    ----------
    joints
        (n,), indices in the vectors (nv,)
    L, F
        (n, n), of `inertia_factor`
    error, velocities
        (n,), of the reference
    v
        (nv,), joint velocities
    D, ratio
        (n, n), of `JointGains`
    push
        (n,), of `JointGains`
    weight
        scale of all these torques, 0 to 1
    share
        scale of the rates of the feedback, for the delay of the loop, 0 to 1
    effort_limits
        (nv,), N m
    given
        (nv,), what the motors give besides
    feedback
        (nv,), written
    stiffness, damping
        (n, n), written

    Returns
    -------
    int
        0, 1 where weak motors made something saturate, -1 where the state cannot be computed with
    """
    n = len(joints)
    half = share * (F @ D)
    K = half.T @ (ratio @ half)
    D = share * D
    pull, brake, own = K @ error + L @ push, np.zeros(n), np.empty(n)
    most, least = np.empty(n), np.empty(n)
    braked = 1.0
    for i in range(n):
        for j in range(n):
            brake[i] += weight * D[i, j] * (velocities[j] - v[joints[j]])
            stiffness[i, j], damping[i, j] = weight * K[i, j], weight * D[i, j]
        pull[i] *= weight
        own[i] = weight * D[i, i] * (velocities[i] - v[joints[i]])
        sofar, limit = given[joints[i]], effort_limits[joints[i]]
        if not (is_finite(pull[i]) and is_finite(brake[i]) and is_finite(sofar)):
            return -1
        most[i], least[i] = max(limit - sofar, 0.0), min(-limit - sofar, 0.0)
        if brake[i] > most[i]:
            braked = min(braked, most[i] / brake[i])
        elif brake[i] < least[i]:
            braked = min(braked, least[i] / brake[i])
    # Damping comes first, and saturates as a whole: with one torque cut, those of the other joints that answer
    # its speed may drive what they should brake. Each joint then adds what is missing by itself, as far as it can.
    # The pull is cut where it is too much, and only there: for the others this is one more push, and they go on
    # holding what they hold. Scaling all would release both arms where one shoulder is too weak. It is never more
    # than the motor's own limit: otherwise a far reference would leave no torque for damping, and the arm would swing.
    saturated = 0 if braked == 1.0 else 1
    for i in range(n):
        together = braked * brake[i]
        braking = together + clamp((1.0 - braked) * own[i], least[i] - together, most[i] - together)
        pulling = clamp(pull[i], max(least[i], least[i] - braking), min(most[i], most[i] - braking))
        if pulling != pull[i]:
            saturated = 1
        feedback[joints[i]] = braking + pulling
    return saturated
