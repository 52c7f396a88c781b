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

from tpgmm_core.common.constants import ORTHOGONAL
from tpgmm_core.common.types import Array

# Sums in the order that is written; a division by zero gives infinity or NaN; no wrapper for callers in C.
EXACT: Any = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# Sums may be reordered and fused so that they vectorise; NaN and infinity keep their meaning.
FAST: Any = {**EXACT, "fastmath": {"reassoc", "contract", "nsz"}}
# What takes the compiler long is written otherwise here: `a[:] = b` between arrays brings the words of a mismatch of
# shapes into each function that uses it, and into its callers; an expression of arrays makes a loop for each layout.
compiled: Any = numba.njit(**FAST)
# For functions with one caller: compiled as a part of it, and not by themselves as well.
inlined: Any = numba.njit(**FAST, inline="always")


@compiled
def is_finite(x: float) -> bool:
    """Whether x is neither NaN nor infinite.

    For compiled code, instead of `math.isfinite`: that subtracts x from itself, and where sums may be reordered, the
    difference of two equal sums is 0 whatever they are.

    Parameters
    ----------
    x
        a number

    Returns
    -------
    bool
        False for NaN and the infinities
    """
    return abs(x) < np.inf


@compiled
def copy(source: Array, out: Array) -> None:
    """Write source (n,) into out (n,)."""
    for i in range(len(source)):
        out[i] = source[i]


@compiled
def copy_rows(source: Array, out: Array) -> None:
    """Write source (m, n) into out (m, n)."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            out[i, j] = source[i, j]


@compiled
def cholesky(S: Array, n: int, L: Array) -> bool:
    """Lower factor L of the leading n x n block of S, S = L L^T.

    The diagonal of L holds reciprocals, since only these are needed.

    Parameters
    ----------
    S
        (n or more, n or more); its lower triangle is read
    n
        size of the block
    L
        (n or more, n or more), written

    Returns
    -------
    bool
        False when S is not positive definite
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
    """Inverse of the leading n x n block of a factor of `cholesky`.

    Parameters
    ----------
    L
        (n or more, n or more), of `cholesky`
    n
        size of the block
    inverse
        (n or more, n or more), written: itself lower triangular; zeros above
    """
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
    """F^T F of the leading n x n lower triangle: the precision, when F is the inverse Cholesky factor.

    Parameters
    ----------
    F
        (n or more, n or more), lower triangular
    n
        size of the block
    out
        (n or more, n or more), written
    """
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for m in range(i, n):
                total += F[m, i] * F[m, j]
            out[i, j] = total
            out[j, i] = total


@compiled
def invert_side_by_side(S: Array, F: Array, out: Array) -> None:
    """Inverses of K matrices at once, by their Cholesky factors; each step is a loop over all, which vectorises.

    Parameters
    ----------
    S
        (n, n, K), symmetric
    F
        (n, n, K), scratch
    out
        (K, n, n), written; the trace is NaN or infinite where a matrix is not positive definite
    """
    n, K = len(S), S.shape[2]
    for j in range(n):
        for i in range(j, n):
            for k in range(K):
                F[i, j, k] = S[i, j, k]
            for m in range(j):
                for k in range(K):
                    F[i, j, k] -= F[i, m, k] * F[j, m, k]
            for k in range(K):  # as in `cholesky`, the diagonal holds reciprocals
                F[i, j, k] = F[i, j, k] * F[j, j, k] if i > j else 1.0 / math.sqrt(F[j, j, k])
    for i in range(n):  # the factor's inverse takes its place, row by row
        for j in range(i):
            for k in range(K):
                F[i, j, k] *= -F[j, j, k]
            for m in range(j + 1, i):
                for k in range(K):
                    F[i, j, k] -= F[i, m, k] * F[m, j, k]
            for k in range(K):
                F[i, j, k] *= F[i, i, k]
    total = np.empty(K)
    for i in range(n):
        for j in range(i + 1):
            for k in range(K):
                total[k] = F[i, i, k] * F[i, j, k]
            for m in range(i + 1, n):
                for k in range(K):
                    total[k] += F[m, i, k] * F[m, j, k]
            for k in range(K):
                out[k, i, j] = total[k]
                out[k, j, i] = total[k]


@compiled
def is_orthogonal(A: Array) -> bool:
    """Whether A^T A = I to rounding."""
    n = len(A)
    for i in range(n):
        for m in range(i + 1):
            total = 0.0
            for c in range(n):
                total += A[i, c] * A[m, c]
            if not abs(total - (1.0 if i == m else 0.0)) < ORTHOGONAL:
                return False
    return True


@compiled
def pseudo_inverse(A: Array, tolerance: float) -> Array:
    """A^+ (n_j, n) of A (n, n_j): A^T of a rotation, by elimination where A is regular, else by singular values."""
    n, n_j = A.shape
    if n == n_j:
        if is_orthogonal(A):
            return A.T.copy()
        inverse = np.zeros((n, n))
        for i in range(n):
            inverse[i, i] = 1.0
        if solve_in_place(A.copy(), inverse, 1e-6):  # where it is doubtful, the singular values decide
            return inverse
    U, s, Vt = np.linalg.svd(A, False)
    inverse = np.zeros((n_j, n))
    for k in range(len(s)):
        if s[k] > tolerance * s[0]:
            for i in range(n_j):
                for m in range(n):
                    inverse[i, m] += Vt[k, i] / s[k] * U[m, k]
    return inverse


@compiled
def solve_in_place(W: Array, X: Array, least_pivot: float) -> bool:
    """Solve W Y = X by Gaussian elimination with row pivots.

    Parameters
    ----------
    W
        (n, n), changed
    X
        (n, m), becomes Y
    least_pivot
        ratio of the smallest to the largest pivot, above which W counts as regular

    Returns
    -------
    bool
        False where W does not; then both arrays mean nothing
    """
    n, width = X.shape
    largest_pivot, smallest_pivot = 0.0, np.inf
    for c in range(n):
        p = c
        for i in range(c + 1, n):
            if abs(W[i, c]) > abs(W[p, c]):
                p = i
        pivot = W[p, c]
        largest_pivot, smallest_pivot = max(largest_pivot, abs(pivot)), min(smallest_pivot, abs(pivot))
        if not abs(pivot) > 0.0 or not smallest_pivot > least_pivot * largest_pivot:
            return False
        if p != c:
            for m in range(c, n):
                W[p, m], W[c, m] = W[c, m], W[p, m]
            for m in range(width):
                X[p, m], X[c, m] = X[c, m], X[p, m]
        for i in range(c + 1, n):
            f = W[i, c] / pivot
            if f != 0.0:
                for m in range(c + 1, n):
                    W[i, m] -= f * W[c, m]
                for m in range(width):
                    X[i, m] -= f * X[c, m]
    for c in range(n - 1, -1, -1):
        for i in range(c + 1, n):
            f = W[c, i]
            for m in range(width):
                X[c, m] -= f * X[i, m]
        for m in range(width):
            X[c, m] /= W[c, c]
    return True


@compiled
def exp_in_place(values: Array, n: int, polynomial: Array, bits: Array, scale: Array) -> None:
    """values[:n] ← exp(values[:n]) for values <= 0, relative error below 1e-14; vectorises, unlike math.exp.

    exp(x) = 2^m exp(r) with |r| <= log(2)/2. Below -700 the result is 1e-304, which stands for zero.

    Parameters
    ----------
    values
        (n or more,), changed
    n
        how many
    polynomial
        (n or more,), scratch
    bits, scale
        (n or more,), scratch: int64, and a float view of the same memory
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


@compiled
def multiply_add(A: Array, x: Array, y: Array) -> None:
    """Add a product in place: y += A x.

    Parameters
    ----------
    A
        (n, m)
    x
        (m,)
    y
        (n,), changed
    """
    for i in range(len(A)):
        total = 0.0
        for j in range(A.shape[1]):
            total += A[i, j] * x[j]
        y[i] += total
