# SPDX-License-Identifier: Apache-2.0
"""Unit quaternions as in ROS messages: x, y, z, w, Hamilton product, shape (..., 4).

All functions are batched over the leading axes and broadcast. Rotation vectors (..., 3) are in radians about
the *fixed* axes: `exp(w)` turns by |w| about w, and `multiply(exp(w), q)` turns q by w about fixed axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.constants import SHORTEST_QUATERNION, UNIT_ROUNDING
from tpgmm_core.common.types import Array

IDENTITY: Array = np.array([0.0, 0.0, 0.0, 1.0])
IDENTITY.setflags(write=False)


def multiply(p: ArrayLike, q: ArrayLike) -> Array:
    """Hamilton product p ⊗ q (first q, then p), shape (..., 4)."""
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    px, py, pz, pw = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    qx, qy, qz, qw = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    return np.stack(
        [
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
            pw * qw - px * qx - py * qy - pz * qz,
        ],
        axis=-1,
    )


def conjugate(q: ArrayLike) -> Array:
    """Inverse of a unit quaternion, shape (..., 4)."""
    return np.asarray(q, dtype=float) * np.array([-1.0, -1.0, -1.0, 1.0])


def normalize(q: ArrayLike) -> Array:
    """Unit quaternions q / |q|; one that is of unit length up to rounding stays as it is, bit by bit.

    So what was normalised, written and read is the same.

    Parameters
    ----------
    q
        shape (..., 4), x, y, z, w

    Returns
    -------
    Array
        shape (..., 4)

    Raises
    ------
    ValueError
        for zero or non-finite quaternions
    """
    q = np.asarray(q, dtype=float)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not (np.all(np.isfinite(norm)) and np.all(norm > SHORTEST_QUATERNION)):
        raise ValueError(f"a quaternion needs a finite norm above zero to be an orientation, got norm {norm.min()}")
    return np.where(np.abs(norm - 1.0) <= UNIT_ROUNDING, q, q / norm)


def exp(rotation_vector: ArrayLike) -> Array:
    """Quaternion (..., 4) of a rotation vector (..., 3), in radians."""
    w = np.asarray(rotation_vector, dtype=float)
    half = 0.5 * np.linalg.norm(w, axis=-1, keepdims=True)
    # sinc(x) = sin(pi x) / (pi x) is smooth at zero, so that no case distinction is needed
    return np.concatenate([0.5 * np.sinc(half / np.pi) * w, np.cos(half)], axis=-1)


def log(q: ArrayLike) -> Array:
    """Shortest rotation vector (..., 3) of a quaternion, norm <= pi rad; log(q) = log(-q)."""
    q = np.asarray(q, dtype=float)
    vector = np.where(q[..., 3:] < 0.0, -q[..., :3], q[..., :3])
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(q[..., 3:]))
    # near the identity angle / sine = 2 (1 + sine^2 / 6 + ...): the limit is exact to rounding below 1e-9
    small = sine < 1e-9
    return vector * np.where(small, 2.0, angle / np.where(small, 1.0, sine))


def rotation_matrix(q: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3) of a unit quaternion (..., 4)."""
    q = np.asarray(q, dtype=float)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def roll_pitch_yaw(q: ArrayLike) -> Array:
    """Turns about the fixed axes x, then y, then z (REP 103) that make up a unit quaternion.

    Where the pitch is a quarter turn, roll and yaw are about the same axis; the whole turn is then given as roll.

    Parameters
    ----------
    q
        shape (4,), x, y, z, w

    Returns
    -------
    Array
        roll, pitch and yaw, (3,), rad
    """
    R = rotation_matrix(q)
    cosine = np.hypot(R[0, 0], R[1, 0])
    pitch = np.arctan2(-R[2, 0], cosine)
    if cosine < 1e-9:
        return np.array([np.arctan2(-np.sign(R[2, 0]) * R[0, 1], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def from_matrix(R: ArrayLike) -> Array:
    """Unit quaternion of a rotation matrix.

    Parameters
    ----------
    R
        shape (..., 3, 3)

    Returns
    -------
    Array
        shape (..., 4), x, y, z, w, with w >= 0

    Raises
    ------
    ValueError
        when R is not a rotation (orthogonal with determinant +1, to 1e-6)
    """
    R = np.asarray(R, dtype=float)
    if R.shape[-2:] != (3, 3):
        raise ValueError(f"a rotation matrix has shape (..., 3, 3), got {R.shape}")
    error = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)).max(initial=0.0)
    if not error < 1e-6 or not np.all(np.linalg.det(R) > 0.0):
        raise ValueError("not a rotation matrix: it must be orthogonal with determinant +1")
    trace = np.trace(R, axis1=-2, axis2=-1)
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    # 4 q q^T holds four multiples of q as its rows; that with the largest diagonal entry is well conditioned
    outer = np.empty(R.shape[:-2] + (4, 4))
    outer[..., :3, :3] = R + np.swapaxes(R, -1, -2)
    outer[..., range(3), range(3)] = 1.0 + 2.0 * diagonal - trace[..., None]
    outer[..., 3, 3] = 1.0 + trace
    axial = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    outer[..., 3, :3] = axial
    outer[..., :3, 3] = axial
    best = np.argmax(outer[..., range(4), range(4)], axis=-1)
    q = normalize(np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :])
    return np.where(q[..., 3:] < 0.0, -q, q)


def left_matrix(q: ArrayLike) -> Array:
    """L(q), shape (..., 4, 4), with L(q) p = q ⊗ p: how a frame acts on quaternions linearly."""
    q = np.asarray(q, dtype=float)
    x, y, z, w = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def continuous(q: ArrayLike) -> Array:
    """Sequence (T, 4) with signs chosen such that neighbours lie on the same half of the sphere."""
    q = np.asarray(q, dtype=float)
    flips = np.sum(q[1:] * q[:-1], axis=-1) < 0.0
    signs = np.where(np.concatenate([[False], np.logical_xor.accumulate(flips)]) if len(q) > 1 else False, -1.0, 1.0)
    return q * signs[..., None] if len(q) else q.copy()


def slerp(p: ArrayLike, q: ArrayLike, fraction: ArrayLike) -> Array:
    """Point at a fraction of the shortest way from one unit quaternion to another.

    Parameters
    ----------
    p, q
        shape (..., 4), x, y, z, w
    fraction
        0 to 1, shape (...,)

    Returns
    -------
    Array
        unit quaternion, shape (..., 4)
    """
    p = np.asarray(p, dtype=float)
    step = np.asarray(fraction, dtype=float)[..., None] * log(multiply(q, conjugate(p)))
    return multiply(exp(step), p)


def angle_between(p: ArrayLike, q: ArrayLike) -> Array:
    """Angle (...,) of the rotation from p to q, 0..pi rad."""
    return np.linalg.norm(log(multiply(q, conjugate(p))), axis=-1)
