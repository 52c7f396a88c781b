# SPDX-License-Identifier: Apache-2.0
"""What is not known of a frame's pose, carried into what the frame says: one that is known badly counts less there."""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, inlined, solve_in_place

#: In directions in which a pose is known this much worse than a component, that says nothing. Larger variances would
#: hide by their rounding what is known in others.
LARGEST_RATIO = 1e10


@compiled
def position_start(flat: Array, spheres: Array) -> int:
    """Where the position starts among the tangent dimensions; -1 for data that are neither positions nor poses.

    Parameters
    ----------
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`: [time, position], position, pose or [time, pose]

    Returns
    -------
    int
        index of the first of three tangent dimensions
    """
    n = len(flat)
    if len(spheres) == 0:
        return n - 3 if n == 3 or n == 4 else -1
    turn = spheres[0, 1]
    return turn - 3 if len(spheres) == 1 and turn + 3 == n and (turn == 3 or turn == 4) else -1


@inlined
def is_uncertain(P: Array) -> bool:
    """Whether a frame's pose is not known exactly, by its covariance (6, 6)."""
    trace = 0.0
    for i in range(len(P)):
        trace += P[i, i]
    return trace > 0.0


@compiled
def bounded(P: Array, largest: float) -> Array:
    """A covariance (6, 6) whose eigenvalues are at most `largest`."""
    values, axes = np.linalg.eigh(P)
    result = np.zeros((6, 6))
    for i in range(6):
        for m in range(6):
            for k in range(6):
                result[i, m] += axes[i, k] * axes[m, k] * min(values[k], largest)
    return result


@inlined
def lessen(P: Array, weight: float, targets: Array, b: Array, flat: Array, spheres: Array, terms: Array) -> None:
    """Precisions of a frame's components, in the common frame, when its own pose is uncertain, to first order.

    A frame that is displaced by d and turned by r about the fixed axes moves the point A mu + b by d + r x (A mu), and
    turns the orientation there by r. With J = [I, -[A mu]x; 0, I], which maps the pose's error to that of the
    component, the covariance A Sigma A^T of Eq. (5) becomes A Sigma A^T + J P J^T.

    Parameters
    ----------
    P
        (6, 6), covariance of the frame's pose: displacement and turn about the fixed axes
    weight
        how far the frame is trusted, by which the terms are scaled
    targets
        (D, K), A mu + b
    b
        (D,), of the frame
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    terms
        (n, n K), precisions; changed
    """
    n, K = len(flat), targets.shape[1]
    p = position_start(flat, spheres)
    J, TJ, PJ = np.zeros((n, 6)), np.empty((n, 6)), np.empty((6, n))
    T, M, less = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(3):
        J[p + i, i] = 1.0
        if len(spheres) > 0:
            J[p + 3 + i, 3 + i] = 1.0
    x = np.empty(3)
    for k in range(K):
        for i in range(3):
            x[i] = targets[flat[p + i], k] - b[flat[p + i]]
        J[p, 4], J[p, 5] = x[2], -x[1]
        J[p + 1, 3], J[p + 1, 5] = -x[2], x[0]
        J[p + 2, 3], J[p + 2, 4] = x[1], -x[0]
        for o in range(n):
            for i in range(n):
                T[o, i] = terms[o, i * K + k] / weight
                less[o, i] = T[o, i]
        sharpest, spread = 0.0, 0.0
        for i in range(6):
            sharp = 0.0
            for o in range(n):
                TJ[o, i] = 0.0
                for m in range(n):
                    TJ[o, i] += T[o, m] * J[m, i]
                sharp += J[o, i] * TJ[o, i]
            sharpest, spread = max(sharpest, sharp), spread + P[i, i]
        known = P if sharpest * spread <= LARGEST_RATIO else bounded(P, LARGEST_RATIO / sharpest)
        for i in range(6):
            for o in range(n):
                PJ[i, o] = 0.0
                for m in range(6):
                    PJ[i, o] += known[i, m] * J[o, m]
        # (T^-1 + J P J^T)^-1 without an inverse of T, which may be singular
        for o in range(n):
            for i in range(n):
                M[o, i] = 1.0 if o == i else 0.0
                for m in range(6):
                    M[o, i] += TJ[o, m] * PJ[m, i]
        is_regular = solve_in_place(M, less, 0.0)  # always, but for numbers that overflow: then nothing is known
        for o in range(n):
            for i in range(n):
                terms[o, i * K + k] = 0.5 * weight * (less[o, i] + less[i, o]) if is_regular else 0.0
