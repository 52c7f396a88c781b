# SPDX-License-Identifier: Apache-2.0
"""Compiled loops on small matrices and quaternions, shared by learning and adaptation.

All functions write into arrays that the caller provides: a control loop allocates nothing. Compiled code is
cached on disk; `python -m tpgmm_core.warm_up` compiles everything ahead.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from tpgmm_core.common.types import Array

# Sums may be reordered and fused so that they vectorise; NaN and infinity keep their meaning.
compiled: Any = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})


@compiled
def cholesky(S: Array, n: int, L: Array) -> bool:
    """Lower factor L of the leading n x n block of S, S = L L^T, from its lower triangle.

    The diagonal of L holds reciprocals, since only these are needed. False when S is not positive definite.
    """
    for j in range(n):
        pivot = S[j, j]
        for m in range(j):
            pivot -= L[j, m] * L[j, m]
        if not pivot > 0.0:
            return False
        reciprocal = 1.0 / math.sqrt(pivot)
        L[j, j] = reciprocal
        for i in range(j + 1, n):
            total = S[i, j]
            for m in range(j):
                total -= L[i, m] * L[j, m]
            L[i, j] = total * reciprocal
    return True


@compiled
def invert_lower(L: Array, n: int, inverse: Array) -> None:
    """Inverse of the leading n x n factor of `cholesky`, itself lower triangular; zeros above."""
    for i in range(n):
        inverse[i, i] = L[i, i]
        for j in range(i):
            total = 0.0
            for m in range(j, i):
                total -= L[i, m] * inverse[m, j]
            inverse[i, j] = total * L[i, i]
            inverse[j, i] = 0.0


@compiled
def gram(F: Array, n: int, out: Array) -> None:
    """F^T F of the leading n x n lower triangle: the precision, when F is the inverse Cholesky factor."""
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for m in range(i, n):
                total += F[m, i] * F[m, j]
            out[i, j] = total
            out[j, i] = total


@compiled
def quaternion_difference(
    px: float, py: float, pz: float, pw: float, qx: float, qy: float, qz: float, qw: float
) -> tuple[float, float, float]:
    """Log(p ⊗ q^-1): the shortest rotation vector from q to p about the fixed axes."""
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
    """Turn a quaternion in place: q ← Exp(w) ⊗ q, normalised."""
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
    """Inverse of the left Jacobian of SO(3) at the rotation vector (x, y, z): d Log(Exp(w) Exp(e)) / dw at w = 0."""
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
    """Rotation matrix of a unit quaternion."""
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
    R[1, 0], R[1, 1], R[1, 2] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
    R[2, 0], R[2, 1], R[2, 2] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)


@compiled
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
    """Move a covariance along the rotation vector (x, y, z) of the S³ factor at t: C ← R C R^T, R = Exp half of it."""
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


@compiled
def is_orthogonal(A: Array) -> bool:
    """Whether A^T A = I to rounding."""
    n = len(A)
    for i in range(n):
        for m in range(i + 1):
            total = 0.0
            for c in range(n):
                total += A[i, c] * A[m, c]
            if not abs(total - (1.0 if i == m else 0.0)) < 1e-14:
                return False
    return True


@compiled
def pseudo_inverse(A: Array, tolerance: float) -> Array:
    """A^+ (n_j, n) of A (n, n_j): A^T of a rotation, by elimination where A is regular, else by singular values."""
    n, n_j = A.shape
    if n == n_j:
        if is_orthogonal(A):
            return A.T.copy()
        W = A.copy()
        inverse = np.eye(n)
        regular = True
        largest_pivot, smallest_pivot = 0.0, np.inf
        for c in range(n):
            p = c
            for i in range(c + 1, n):
                if abs(W[i, c]) > abs(W[p, c]):
                    p = i
            pivot = W[p, c]
            largest_pivot, smallest_pivot = max(largest_pivot, abs(pivot)), min(smallest_pivot, abs(pivot))
            if not smallest_pivot > 1e-6 * largest_pivot:  # doubtful: the singular values decide
                regular = False
                break
            for m in range(n):
                scaled, scaled_inverse = W[p, m] / pivot, inverse[p, m] / pivot
                W[p, m], inverse[p, m] = W[c, m], inverse[c, m]
                W[c, m], inverse[c, m] = scaled, scaled_inverse
            for i in range(n):
                f = W[i, c]
                if i != c and f != 0.0:
                    for m in range(n):
                        W[i, m] -= f * W[c, m]
                        inverse[i, m] -= f * inverse[c, m]
        if regular:
            return inverse
    U, s, Vt = np.linalg.svd(A, False)
    for i in range(len(s)):
        factor = 1.0 / s[i] if s[i] > tolerance * s[0] else 0.0
        for m in range(n_j):
            Vt[i, m] *= factor
    return np.ascontiguousarray(Vt.T) @ np.ascontiguousarray(U.T)


@compiled
def exp_in_place(values: Array, n: int, polynomial: Array, bits: Array, scale: Array) -> None:
    """values[:n] ← exp(values[:n]) for values <= 0, relative error below 1e-14; vectorises, unlike math.exp.

    exp(x) = 2^m exp(r) with |r| <= log(2)/2. `polynomial`, `bits` (int64) and `scale`, a float view of
    `bits`, are scratch of at least n numbers. Below -700 the result is 1e-304, which stands for zero.
    """
    for b in range(n):
        x = max(values[b], -700.0)
        m = np.floor(x * 1.4426950408889634 + 0.5)  # of numpy: stays a float, which vectorises
        r = x - m * 0.6931471805599453
        p = 1.0 / 6227020800.0
        p = p * r + 1.0 / 479001600.0
        p = p * r + 1.0 / 39916800.0
        p = p * r + 1.0 / 3628800.0
        p = p * r + 1.0 / 362880.0
        p = p * r + 1.0 / 40320.0
        p = p * r + 1.0 / 5040.0
        p = p * r + 1.0 / 720.0
        p = p * r + 1.0 / 120.0
        p = p * r + 1.0 / 24.0
        p = p * r + 1.0 / 6.0
        p = p * r + 0.5
        p = p * r + 1.0
        polynomial[b] = p * r + 1.0
        bits[b] = (np.int64(m) + 1023) << 52
    for b in range(n):
        values[b] = polynomial[b] * scale[b]
