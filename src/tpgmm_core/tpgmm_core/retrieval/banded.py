# SPDX-License-Identifier: Apache-2.0
"""Symmetric banded matrices, compiled: Cholesky factor, solution, and the band of the inverse; linear in their size.

A matrix of N rows with w entries below its diagonal is held by rows, (N, w + 1): entry (i, j), i - w <= j <= i, lies at
[i, w - i + j], so that inner loops run along memory.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.kernels import compiled
from tpgmm_core.quaternion import Array


@compiled
def cholesky_band(band: Array) -> bool:
    """band ← its Cholesky factor L (N, w + 1), with reciprocals on the diagonal; False when it is not definite."""
    N, w = band.shape[0], band.shape[1] - 1
    for i in range(N):
        first, row, shift = max(0, i - w), band[i], w - i
        for j in range(first, i + 1):
            other, other_shift = band[j], w - j
            total = row[shift + j]
            for k in range(first, j):
                total -= row[shift + k] * other[other_shift + k]
            if j < i:
                row[shift + j] = total * other[w]
            elif total > 0.0:
                row[w] = 1.0 / math.sqrt(total)
            else:
                return False
    return True


@compiled
def solve_band(factor: Array, x: Array) -> None:
    """x (N,) ← (L L^T)^-1 x, with the factor of `cholesky_band`."""
    N, w = factor.shape[0], factor.shape[1] - 1
    for i in range(N):
        total, row, shift = x[i], factor[i], w - i
        for k in range(max(0, i - w), i):
            total -= row[shift + k] * x[k]
        x[i] = total * row[w]
    for i in range(N - 1, -1, -1):
        row, shift = factor[i], w - i
        x[i] *= row[w]
        for k in range(max(0, i - w), i):
            x[k] -= row[shift + k] * x[i]


@compiled
def inverse_band(factor: Array, inverse: Array) -> None:
    """Entries of Z = (L L^T)^-1 within the band of the factor L of `cholesky_band` (Takahashi et al. 1973).

    inverse : shape (N, 2 w + 1), what is written: Z[i, j], |i - j| <= w, at [i, w - i + j]

    L^T Z = L^-1 is lower triangular with 1 / L[j, j] on its diagonal, so that from the last column to the first each
    entry of Z follows from later ones of the band.
    """
    N, w = factor.shape[0], factor.shape[1] - 1
    column = np.empty(w)
    for j in range(N - 1, -1, -1):
        last, reciprocal = min(N - 1, j + w), factor[j, w]
        for k in range(j + 1, last + 1):
            column[k - j - 1] = factor[k, w - k + j]
        diagonal = reciprocal
        for i in range(last, j, -1):
            row, shift = inverse[i], w - i
            total = 0.0
            for k in range(j + 1, last + 1):
                total -= column[k - j - 1] * row[shift + k]
            total *= reciprocal
            row[shift + j] = total
            inverse[j, w - j + i] = total
            diagonal -= column[i - j - 1] * total
        inverse[j, w] = diagonal * reciprocal
