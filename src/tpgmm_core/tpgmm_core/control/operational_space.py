# SPDX-License-Identifier: Apache-2.0
"""The hand as a mass in space: bounded motions, and the inertia that the hand feels (Khatib 1987); compiled.

Vectors (6,) are linear, then angular, in base axes. A length makes the two comparable: turning by 1 rad
counts as moving by that many metres.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, gram, inlined, invert_lower, is_finite


@compiled
def bound_twist(twist: Array, max_linear: float, max_angular: float) -> None:
    """Scale the linear and the angular part of a motion (6,) in place down to at most max_linear and max_angular."""
    for start, largest in ((0, max_linear), (3, max_angular)):
        x, y, z = twist[start], twist[start + 1], twist[start + 2]
        # by the largest number, so that no square overflows
        scale = max(abs(x), abs(y), abs(z))
        if scale <= largest / 2.0:
            continue
        norm = scale * math.sqrt((x / scale) ** 2 + (y / scale) ** 2 + (z / scale) ** 2)
        if norm > largest:
            for i in range(start, start + 3):
                twist[i] *= largest / norm


@compiled
def invert_inertia(M: Array, inverse: Array) -> bool:
    """M^-1 (n, n) of a joint-space inertia. False where M is not positive definite, or not finite."""
    n = len(M)
    L, F = np.empty((n, n)), np.empty((n, n))
    if not cholesky(M, n, L):
        return False
    invert_lower(L, n, F)
    gram(F, n, inverse)
    return True


@inlined
def operational_space(
    J: Array, M: Array, length: float, max_inertia: float, Lambda: Array, torques: Array, accelerations: Array
) -> bool:
    """Inertia of the hand, and how its accelerations become torques of the n joints that move it.

    Parameters
    ----------
    J
        (6, n), Jacobian
    M
        (n, n), joint-space inertia
    length
        m, for which turning counts by max_inertia
    max_inertia
        kg. Near singularities the hand cannot move in some direction, and its inertia there grows without bound; in no
        direction it is taken for more than this. Elsewhere Lambda is exact
    Lambda
        (6, 6), written: (J M^-1 J^T)^-1
    torques
        (n, 6), written: J^T Lambda, torques that accelerate the hand and do not move the null space
    accelerations
        (6, n), written: J M^-1, accelerations of the hand under torques

    Returns
    -------
    bool
        False where M is not positive definite, or something is not finite
    """
    n = len(M)
    inverse = np.empty((n, n))
    if not invert_inertia(M, inverse):
        return False
    mobility = np.empty((6, 6))
    for i in range(6):
        for j in range(n):
            accelerations[i, j] = 0.0
            for k in range(n):
                accelerations[i, j] += J[i, k] * inverse[k, j]
    for i in range(6):
        for j in range(6):
            mobility[i, j] = 0.0
            for k in range(n):
                mobility[i, j] += accelerations[i, k] * J[j, k]
            if not is_finite(mobility[i, j]):
                return False
            mobility[i, j] *= (1.0 if i < 3 else length) * (1.0 if j < 3 else length)
    eigenvalues, axes = np.linalg.eigh(mobility)
    for i in range(3, 6):
        for k in range(6):
            axes[i, k] *= length
    for i in range(6):
        for j in range(6):
            total = 0.0
            for k in range(6):
                total += axes[i, k] * axes[j, k] / max(eigenvalues[k], 1.0 / max_inertia)
            Lambda[i, j] = total
    for i in range(n):
        for j in range(6):
            torques[i, j] = 0.0
            for k in range(6):
                torques[i, j] += J[k, i] * Lambda[k, j]
    return True
