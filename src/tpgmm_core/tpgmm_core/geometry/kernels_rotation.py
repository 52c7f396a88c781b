# SPDX-License-Identifier: Apache-2.0
"""Compiled loops on quaternions and rotation matrices; they write into arrays that the caller provides."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, inlined


@compiled
def quaternion_difference(
    px: float, py: float, pz: float, pw: float, qx: float, qy: float, qz: float, qw: float
) -> tuple[float, float, float]:
    """Log(p ⊗ q^-1): the shortest rotation vector from q to p about the fixed axes.

    Parameters
    ----------
    px, py, pz, pw
        unit quaternion p
    qx, qy, qz, qw
        unit quaternion q

    Returns
    -------
    tuple[float, float, float]
        x, y, z, rad
    """
    x = -pw * qx + px * qw - py * qz + pz * qy
    y = -pw * qy + px * qz + py * qw - pz * qx
    z = -pw * qz - px * qy + py * qx + pz * qw
    w = pw * qw + px * qx + py * qy + pz * qz
    sine = math.sqrt(x * x + y * y + z * z)
    if sine < 1e-9:
        factor = 2.0
    else:
        factor = 2.0 * math.atan2(sine, abs(w)) / sine
    if w < 0.0:
        factor = -factor
    return factor * x, factor * y, factor * z


@compiled
def turn(q: Array, wx: float, wy: float, wz: float) -> None:
    """Turn a quaternion in place: q ← Exp(w) ⊗ q, normalised.

    Parameters
    ----------
    q
        (4,), changed
    wx, wy, wz
        rotation vector about the fixed axes, rad
    """
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    factor = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    c, x, y, z = math.cos(0.5 * angle), factor * wx, factor * wy, factor * wz
    qx, qy, qz, qw = q[0], q[1], q[2], q[3]
    q[0] = c * qx + x * qw + y * qz - z * qy
    q[1] = c * qy - x * qz + y * qw + z * qx
    q[2] = c * qz + x * qy - y * qx + z * qw
    q[3] = c * qw - x * qx - y * qy - z * qz
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] /= norm


@compiled
def inverse_left_jacobian(x: float, y: float, z: float, J: Array) -> None:
    """Inverse of the left Jacobian of SO(3): d Log(Exp(w) Exp(e)) / dw at w = 0.

    Parameters
    ----------
    x, y, z
        the rotation vector e, rad
    J
        (3, 3), written
    """
    squared = x * x + y * y + z * z
    if squared < 1e-8:
        c = 1.0 / 12.0 + squared / 720.0
    else:
        half = 0.5 * math.sqrt(squared)
        c = (1.0 - half * math.cos(half) / math.sin(half)) / squared
    J[0, 0], J[0, 1], J[0, 2] = 1.0 - c * (y * y + z * z), 0.5 * z + c * x * y, -0.5 * y + c * x * z
    J[1, 0], J[1, 1], J[1, 2] = -0.5 * z + c * x * y, 1.0 - c * (x * x + z * z), 0.5 * x + c * y * z
    J[2, 0], J[2, 1], J[2, 2] = 0.5 * y + c * x * z, -0.5 * x + c * y * z, 1.0 - c * (x * x + y * y)


@compiled
def rotation(x: float, y: float, z: float, w: float, R: Array) -> None:
    """Rotation matrix of a unit quaternion.

    Parameters
    ----------
    x, y, z, w
        the quaternion
    R
        (3, 3), written
    """
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    R[1, 0], R[1, 1], R[1, 2] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    R[2, 0], R[2, 1], R[2, 2] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@inlined
def rotation_of_left_matrix(L: Array, R: Array) -> bool:
    """R (3, 3) of the left multiplication L(q) (4, 4); False when L is no left multiplication by a unit quaternion."""
    x, y, z, w = L[0, 3], L[1, 3], L[2, 3], L[3, 3]
    if not abs(x * x + y * y + z * z + w * w - 1.0) < 1e-6:
        return False
    # L(q)^T = L(q^-1): the diagonal is w, and entries across it have opposite signs
    error = abs(L[0, 0] - w) + abs(L[1, 1] - w) + abs(L[2, 2] - w)
    error += abs(L[1, 0] - z) + abs(L[0, 1] + z) + abs(L[0, 2] - y) + abs(L[2, 0] + y)
    error += abs(L[2, 1] - x) + abs(L[1, 2] + x)
    error += abs(L[3, 0] + x) + abs(L[3, 1] + y) + abs(L[3, 2] + z)
    rotation(x, y, z, w, R)
    return error < 1e-6


@compiled
def transport(C: Array, t: int, x: float, y: float, z: float) -> None:
    """Move a covariance along a rotation vector: C ← R C R^T, R = Exp half of it.

    Parameters
    ----------
    C
        (n, n), changed
    t
        first tangent index of the S³ factor
    x, y, z
        the rotation vector, rad
    """
    n = len(C)
    q = np.array([0.0, 0.0, 0.0, 1.0])
    turn(q, 0.5 * x, 0.5 * y, 0.5 * z)
    R = np.empty((3, 3))
    rotation(q[0], q[1], q[2], q[3], R)
    for i in range(n):
        c0, c1, c2 = C[i, t], C[i, t + 1], C[i, t + 2]
        for m in range(3):
            C[i, t + m] = R[m, 0] * c0 + R[m, 1] * c1 + R[m, 2] * c2
    for i in range(n):
        c0, c1, c2 = C[t, i], C[t + 1, i], C[t + 2, i]
        for m in range(3):
            C[t + m, i] = R[m, 0] * c0 + R[m, 1] * c1 + R[m, 2] * c2
