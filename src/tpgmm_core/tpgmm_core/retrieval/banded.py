# SPDX-License-Identifier: Apache-2.0
"""Symmetric banded matrices, compiled: Cholesky factor and solution, in linear time.

A matrix of N rows with w entries below its diagonal is stored by rows, (N, w + 1): entry (i, j), i - w <= j <= i, is at
[i, w - i + j]. Inner loops run along memory and add multiples of rows, which the compiler vectorises; it does not
vectorise sums of products.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import inlined


@inlined
def cholesky_band(band: Array) -> bool:
    """Replace band by its Cholesky factor L (N, w + 1), reciprocals on the diagonal; False when it is not definite."""
    N, w = band.shape[0], band.shape[1] - 1
    column = np.empty(w)
    for j in range(N):
        pivot, count = band[j, w], min(w, N - 1 - j)
        if not pivot > 0.0:
            return False
        reciprocal = band[j, w] = 1.0 / math.sqrt(pivot)
        for i in range(count):
            column[i] = band[j + 1 + i, w - 1 - i] = reciprocal * band[j + 1 + i, w - 1 - i]
        for i in range(count):
            row, share = band[j + 1 + i, w - i :], column[i]
            for k in range(i + 1):
                row[k] -= share * column[k]
    return True


@inlined
def solve_band(factor: Array, x: Array) -> None:
    """Replace x (N,) by (L L^T)^-1 x, with the factor of `cholesky_band`."""
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
