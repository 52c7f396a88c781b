# SPDX-License-Identifier: Apache-2.0
"""`CovarianceFade`: a covariance that has become another one at once, and is shown without a jump."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.kernels import cholesky, compiled, invert_lower
from tpgmm_core.quaternion import Array

NEGLIGIBLE = 1e-15  # of what is left: rounding hides it
SMALLEST = 1e-15  # of the ratios, as a share of the largest: smaller ones are rounding


class CovarianceFade:
    """What is left, at present, of the difference to a former covariance: a ratio that dies out.

    Shown is M C M^T of the covariance C that the course says, whatever it is at that time. When C takes the place of a
    covariance S that was shown, M = (S C^-1)^(1/2), hence nothing jumps; then log M dies out exponentially. With C at
    rest this is the shortest way from S to C among covariances (the geodesic of the affine-invariant metric). So

    - what is shown is positive definite and symmetric, as C is;
    - it goes along with C in time: while all that changes is noise, M is the identity but for that noise, and the next
      change begins where the former one has come to;
    - another frame of reference, turned, scaled or skewed, sees the same.

    time_constant : s; n : size of the covariances
    """

    def __init__(self, n: int, time_constant: float) -> None:
        self.time_constant = time_constant
        self._basis, self._inverse, self._logs = np.eye(n), np.eye(n), np.zeros(n)
        self.forget()
        self.take_over(np.eye(n), np.eye(n))  # compiled, or loaded from the cache
        self.of(np.eye(n))
        self.forget()

    def forget(self) -> None:
        """Nothing of it is left."""
        self._largest = 0.0
        self._logs[:] = 0.0

    @property
    def is_gone(self) -> bool:
        """Whether what the course says is what is shown."""
        return self._largest == 0.0

    def take_over(self, shown: Array, present: Array) -> None:
        """Go on from what is shown, where the course now says `present`; both (n, n). What is singular is let go."""
        shown, present = np.ascontiguousarray(shown), np.ascontiguousarray(present)  # other layouts are not compiled
        if relate(shown, present, self._basis, self._inverse, self._logs):
            self._largest = float(np.abs(self._logs).max())
        else:
            self.forget()

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        if self._largest > 0.0:
            left = math.exp(-seconds / self.time_constant)
            self._logs *= left
            self._largest *= left
            if self._largest < NEGLIGIBLE:
                self.forget()

    def of(self, covariance: Array, ahead: float = 0.0) -> Array:
        """What is shown, (n, n), where the course says `covariance`; so many seconds ahead."""
        if self._largest == 0.0:
            return covariance
        shown, share = np.empty(covariance.shape), math.exp(-ahead / self.time_constant)
        multiply(np.ascontiguousarray(covariance), self._basis, self._inverse, self._logs, share, shown)
        return shown


@compiled
def relate(shown: Array, present: Array, basis: Array, inverse: Array, logs: Array) -> bool:
    """Writes the logarithm of M = (shown present^-1)^(1/2): basis diag(logs) inverse, where inverse = basis^-1.

    From the ratio as the present covariance sees it, L^-1 shown L^-T with L L^T = present, which is close to the
    identity where little has changed, however long and thin both are. False where one is not positive definite.
    """
    n = len(logs)
    L, back = np.empty((n, n)), np.empty((n, n))
    if not (cholesky(shown, n, L) and cholesky(present, n, L)):
        return False
    invert_lower(L, n, back)
    half, ratio = np.zeros((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            for m in range(i + 1):
                half[i, j] += back[i, m] * shown[m, j]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for m in range(j + 1):
                total += half[i, m] * back[j, m]
            ratio[i, j] = ratio[j, i] = total
    values, V = np.linalg.eigh(ratio)
    smallest = SMALLEST * values[n - 1]
    for i in range(n):
        logs[i] = 0.5 * math.log(max(values[i], smallest))
    for i in range(n):
        for j in range(n):
            basis[i, j] = V[i, j] / L[i, i]  # the diagonal of L holds reciprocals
            inverse[i, j] = 0.0
            for m in range(i):
                basis[i, j] += L[i, m] * V[m, j]
            for m in range(j, n):
                inverse[i, j] += V[m, i] * back[m, j]
    return True


@compiled
def multiply(covariance: Array, basis: Array, inverse: Array, logs: Array, share: float, out: Array) -> None:
    """out = M covariance M^T, with M = basis diag(exp(share logs)) inverse."""
    n = len(logs)
    M, half = np.eye(n), np.zeros((n, n))
    for k in range(n):
        grown = math.expm1(share * logs[k])
        for i in range(n):
            for j in range(n):
                M[i, j] += basis[i, k] * grown * inverse[k, j]
    for i in range(n):
        for m in range(n):
            for j in range(n):
                half[i, j] += M[i, m] * covariance[m, j]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for m in range(n):
                total += half[i, m] * M[j, m]
            out[i, j] = out[j, i] = total
