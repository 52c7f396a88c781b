# SPDX-License-Identifier: Apache-2.0
"""Tangent vectors on R^n and S³, compiled.

`flat[i]` is the ambient index of tangent dimension i, or -1 on S³, and `spheres[s]` = (first ambient, first tangent
index) of each S³ factor: `Manifold.ambient_of_tangent` and `Manifold.sphere_starts`.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.constants import SHORTEST_QUATERNION, UNIT_ROUNDING
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, is_finite
from tpgmm_core.geometry.kernels_rotation import quaternion_difference, rotation, turn


@compiled
def difference(x: Array, base: Array, flat: Array, spheres: Array, out: Array) -> None:
    """Tangent vector between two points, log_base(x).

    Parameters
    ----------
    x, base
        (D,)
    flat, spheres
        see the module
    out
        (n,), written
    """
    for i in range(len(flat)):
        if flat[i] >= 0:
            out[i] = x[flat[i]] - base[flat[i]]
    for s in range(len(spheres)):
        a, t = spheres[s]
        out[t], out[t + 1], out[t + 2] = quaternion_difference(
            x[a], x[a + 1], x[a + 2], x[a + 3], base[a], base[a + 1], base[a + 2], base[a + 3]
        )


@compiled
def transport_matrix(v: Array, spheres: Array, T: Array) -> None:
    """Parallel transport along a tangent vector: on S³ the rotation by half of it, else nothing.

    Parameters
    ----------
    v
        (n,), of the point that is transported to, as seen from the one that is transported from
    spheres
        see the module
    T
        (n, n), written
    """
    T[:] = 0.0
    for i in range(len(v)):
        T[i, i] = 1.0
    q = np.empty(4)
    for s in range(len(spheres)):
        t = spheres[s, 1]
        q[:] = 0.0
        q[3] = 1.0
        turn(q, 0.5 * v[t], 0.5 * v[t + 1], 0.5 * v[t + 2])
        rotation(q[0], q[1], q[2], q[3], T[t : t + 3, t : t + 3])


@compiled
def normalize_point(x: Array, spheres: Array) -> bool:
    """Normalise the quaternions of a point, those that are not of unit length up to rounding.

    Parameters
    ----------
    x
        (D,), changed
    spheres
        see the module

    Returns
    -------
    bool
        False where a number is not finite, or a quaternion too short to be an orientation
    """
    for i in range(len(x)):
        if not is_finite(x[i]):
            return False
    for s in range(len(spheres)):
        q = x[spheres[s, 0] : spheres[s, 0] + 4]
        norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        if not SHORTEST_QUATERNION < norm < np.inf:
            return False
        if abs(norm - 1.0) > UNIT_ROUNDING:
            for i in range(4):
                q[i] /= norm
    return True


@compiled
def is_symmetric(S: Array) -> bool:
    """Whether a matrix (n, n) is finite and symmetric, but for rounding."""
    largest, apart = 0.0, 0.0
    for i in range(len(S)):
        for m in range(len(S)):
            if not is_finite(S[i, m]):
                return False
            largest = max(largest, abs(S[i, m]))
            apart = max(apart, abs(S[i, m] - S[m, i]))
    return apart <= 1e-8 * largest


@compiled
def longest(step: Array) -> float:
    """Largest absolute entry.

    Parameters
    ----------
    step
        (n,)

    Returns
    -------
    float
        0 for an empty one
    """
    result = 0.0
    for i in range(len(step)):
        result = max(result, abs(step[i]))
    return result


@compiled
def move(x: Array, step: Array, flat: Array, spheres: Array) -> None:
    """Move a point in place: x ← exp_x(step).

    Parameters
    ----------
    x
        (D,), changed
    step
        (n,)
    flat, spheres
        see the module
    """
    for i in range(len(flat)):
        if flat[i] >= 0:
            x[flat[i]] += step[i]
    for s in range(len(spheres)):
        a, t = spheres[s]
        turn(x[a : a + 4], step[t], step[t + 1], step[t + 2])


@compiled
def continued_difference(x: Array, base: Array, flat: Array, spheres: Array, out: Array) -> None:
    """`difference`, but on S³ the turn between the quaternions as their signs are, up to 2 pi.

    It is smooth where the shortest turn changes sides.

    Parameters
    ----------
    x, base
        (D,)
    flat, spheres
        see the module
    out
        (n,), written
    """
    for i in range(len(flat)):
        if flat[i] >= 0:
            out[i] = x[flat[i]] - base[flat[i]]
    for s in range(len(spheres)):
        a, t = spheres[s]
        px, py, pz, pw = x[a], x[a + 1], x[a + 2], x[a + 3]
        qx, qy, qz, qw = base[a], base[a + 1], base[a + 2], base[a + 3]
        vx = -pw * qx + px * qw - py * qz + pz * qy
        vy = -pw * qy + px * qz + py * qw - pz * qx
        vz = -pw * qz - px * qy + py * qx + pz * qw
        sine = math.sqrt(vx * vx + vy * vy + vz * vz)
        factor = 2.0
        if sine > 1e-9:
            factor = 2.0 * math.atan2(sine, pw * qw + px * qx + py * qy + pz * qz) / sine
        out[t], out[t + 1], out[t + 2] = factor * vx, factor * vy, factor * vz


@compiled
def along(x: Array, y: Array, a: int) -> float:
    """Scalar product of two quaternions.

    Parameters
    ----------
    x, y
        (D,)
    a
        first ambient index of the quaternions

    Returns
    -------
    float
        positive where both lie on the same half of the sphere
    """
    total: float = x[a] * y[a] + x[a + 1] * y[a + 1] + x[a + 2] * y[a + 2] + x[a + 3] * y[a + 3]
    return total
