# SPDX-License-Identifier: Apache-2.0
"""Tangent vectors on R^n and S³, compiled.

`flat[i]` is the ambient index of tangent dimension i, or -1 on S³, and `spheres[s]` = (first ambient, first tangent
index) of each S³ factor: `Manifold.ambient_of_tangent` and `Manifold.sphere_starts`.
"""

from __future__ import annotations

import math

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.kernels_rotation import quaternion_difference, turn


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
