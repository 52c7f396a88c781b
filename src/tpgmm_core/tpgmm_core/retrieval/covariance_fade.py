# SPDX-License-Identifier: Apache-2.0
"""`CovarianceFade`: a covariance that changes suddenly, shown without a jump."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, gram, invert_lower

NEGLIGIBLE = 1e-15  # of what is left: rounding hides it
SMALLEST = 1e-15  # of the ratios, as a share of the largest: smaller ones are rounding
SHORTEST = 1.0 / 32.0  # of what lasts, as a share of the time constant


class CovarianceFade:
    """What remains, at present, of the difference to a former covariance: a ratio that dies out.

    The covariance of the reference is M C M^T, with C the covariance of the course at that time. When C replaces a
    covariance S that was shown, M = (S C^-1)^(1/2), so that nothing jumps; then log M dies out exponentially. With C at
    rest this is the shortest way from S to C among covariances (the geodesic of the affine-invariant metric). So

    - what is shown is positive definite and symmetric, as C is; - it follows C in time: while all changes are noise, M
    is the identity except for that noise, and the next change begins
      where the former one has come to;
    - in another frame of reference, turned, scaled or skewed, it is the same.

    A ratio that holds for a moment only, for example when one component takes over from another a little later, dies
    out as fast as it would have passed by itself.

    Parameters
    ----------
    n
        size of the covariances
    time_constant
        s, of differences that last
    """

    def __init__(self, n: int, time_constant: float) -> None:
        self.time_constant = time_constant
        self._basis, self._inverse, self._logs = np.eye(n), np.eye(n), np.zeros(n)
        self.forget()
        self.take_over(2.0 * np.eye(n), np.eye(n))  # compiled, or loaded from the cache
        self.lasting(np.ones((2, n, n)) + np.eye(n), np.ones((2, n, n)) + np.eye(n), np.array([0.0, 1.0]))
        self.of(np.eye(n))
        self.forget()

    def forget(self) -> None:
        """Show the covariance of the course from now on."""
        self._largest = 0.0
        self._logs[:] = 0.0
        self._time = self.time_constant

    @property
    def is_gone(self) -> bool:
        """Whether the covariance of the course is shown as it is."""
        return self._largest == 0.0

    def lasting(self, former: Array, present: Array, moments: Array) -> float:
        """The share of the time for which two courses differ as much as at the first moment.

        Parameters
        ----------
        former, present
            covariances (M, n, n) of the courses
        moments
            (M,), s

        Returns
        -------
        float
            0 to 1
        """
        return float(lasting(np.array(former, order="C"), np.array(present, order="C"), moments))

    def take_over(self, shown: Array, present: Array, lasts: float = 1.0) -> None:
        """Continue from the covariance that is shown. Singular covariances are ignored.

        Parameters
        ----------
        shown
            (n, n), the last one that was shown
        present
            (n, n), of the present course
        lasts
            the share of the time constant with which the difference of both courses dies out; what remains of former
            differences counts by its size
        """
        shown, present = np.array(shown, order="C"), np.array(present, order="C")  # as compiled: not read-only
        left = self._largest
        if not relate(shown, present, self._basis, self._inverse, self._logs):
            self.forget()
            return
        self._largest = float(np.abs(self._logs).max())
        added = max(self._largest - left, 0.0)
        if added + left > 0.0:
            lasts = max(lasts, SHORTEST)
            self._time = (added * lasts * self.time_constant + left * self._time) / (added + left)

    def advance(self, seconds: float) -> None:
        """Let this time pass, s."""
        if self._largest > 0.0:
            left = math.exp(-seconds / self._time)
            self._logs *= left
            self._largest *= left
            if self._largest < NEGLIGIBLE:
                self.forget()

    def of(self, covariance: Array, ahead: float = 0.0) -> Array:
        """The covariance (n, n) that is shown where the course has `covariance`; both a time `ahead`, s."""
        if self._largest == 0.0:
            return covariance
        shown, share = np.empty(covariance.shape), math.exp(-ahead / self._time)
        multiply(np.array(covariance, order="C"), self._basis, self._inverse, self._logs, share, shown)
        return shown


@compiled
def relate(shown: Array, present: Array, basis: Array, inverse: Array, logs: Array) -> bool:
    """Write the logarithm of M = (shown present^-1)^(1/2): basis diag(logs) inverse, where inverse = basis^-1.

    It is computed from the ratio in coordinates of the present covariance, L^-1 shown L^-T with L L^T = present, which
    is close to the identity where little has changed, however long and thin both are.

    Parameters
    ----------
    shown, present
        covariances, (n, n)
    basis, inverse
        (n, n), written
    logs
        (n,), written

    Returns
    -------
    bool
        False where one of them is not positive definite
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
def lasting(former: Array, present: Array, moments: Array) -> float:
    """How long two courses differ, from the logarithms of former_j present_j^-1 over some moments.

    Parameters
    ----------
    former, present
        covariances, (M, n, n)
    moments
        when they are compared, (M,)

    Returns
    -------
    float
        their mean size, as a share of the first one; 0 to 1
    """
    n, area, first, last = former.shape[1], 0.0, 0.0, 0.0
    for j in range(len(moments)):
        trace = _trace_of_ratio(former[j], present[j]) + _trace_of_ratio(present[j], former[j])
        size = math.asinh(0.5 * math.sqrt(max(trace - 2.0 * n, 0.0)))  # r + 1 / r - 2 = 4 sinh²(log r / 2)
        if j == 0:
            first = size
        else:
            area += 0.5 * (moments[j] - moments[j - 1]) * (last + size)
        last = size
    whole = first * (moments[-1] - moments[0])
    return min(area / whole, 1.0) if 0.0 < whole < np.inf else 1.0


@compiled
def _trace_of_ratio(one: Array, other: Array) -> float:
    """Trace of one other^-1; infinite where the other one is not positive definite."""
    n = len(one)
    L, back = np.empty((n, n)), np.empty((n, n))
    if not cholesky(other, n, L):
        return np.inf
    invert_lower(L, n, back)
    gram(back, n, L)
    total = 0.0
    for i in range(n):
        for j in range(n):
            total += one[i, j] * L[i, j]
    return total


@compiled
def multiply(covariance: Array, basis: Array, inverse: Array, logs: Array, share: float, out: Array) -> None:
    """Product out = M covariance M^T, with M = basis diag(exp(share logs)) inverse."""
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
