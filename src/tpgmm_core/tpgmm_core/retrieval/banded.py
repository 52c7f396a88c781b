# SPDX-License-Identifier: Apache-2.0
"""The band of the inverse of a banded matrix, without the rest of it: linear in its size."""

from __future__ import annotations

from tpgmm_core.kernels import compiled
from tpgmm_core.quaternion import Array


@compiled
def inverse_band(factor: Array, inverse: Array) -> None:
    """Entries of (L L^T)^-1 within the band of the Cholesky factor L (Takahashi et al. 1973).

    factor : shape (w + 1, n), L in the lower form of `scipy.linalg.cholesky_banded`, L[i, j] at [i - j, j]
    inverse : shape (w + 1, n), what is written, in the same form; entries below the matrix are not touched

    With Z = (L L^T)^-1, L^T Z = L^-1 is lower triangular with 1 / L[j, j] on its diagonal, so that from the last column
    to the first each entry of Z follows from later ones of the band.
    """
    w, n = factor.shape[0] - 1, factor.shape[1]
    for j in range(n - 1, -1, -1):
        last = min(n - 1, j + w)
        for i in range(last, j - 1, -1):
            total = 1.0 / factor[0, j] if i == j else 0.0
            for k in range(j + 1, last + 1):
                total -= factor[k - j, j] * (inverse[i - k, k] if i >= k else inverse[k - i, i])
            inverse[i - j, j] = total / factor[0, j]
