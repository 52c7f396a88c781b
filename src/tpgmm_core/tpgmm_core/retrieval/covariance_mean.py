# SPDX-License-Identifier: Apache-2.0
"""`CovarianceMean`: a weighted mean of covariances of very different size, in which little weight counts little."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.kernels import cholesky, compiled, invert_lower
from tpgmm_core.geometry.kernels_manifold import difference
from tpgmm_core.geometry.kernels_rotation import transport
from tpgmm_core.geometry.manifold import Manifold

SMALLEST = 1e-15  # of the eigenvalues, as a share of the largest: smaller ones are rounding


class CovarianceMean:
    """Log-Euclidean means of K covariances and of one at a goal (Arsigny et al. 2006), as the latter sees them.

    With the goal's covariance G = L L^T, and C_k moved to the goal by parallel transport, the mean is

        L exp(sum_k w_k log(L^-1 C_k L^-T)) L^T,

    where the goal has the weight 1 - sum_k w_k, and its logarithm is 0. Standard deviations pass from one component to
    another as powers do. In a sum of covariances a hundredth of one that is 8 times as wide adds two thirds to a
    variance; here it adds 4 %. And

    - precisions have the same mean, so that stiffness passes over as softness does;
    - another frame of reference, turned, scaled or skewed, sees the same.

    Parameters
    ----------
    manifold
        of the points
    K
        number of covariances besides the goal's
    """

    def __init__(self, manifold: Manifold, K: int) -> None:
        n = manifold.tangent_dim
        self._layout = manifold.ambient_of_tangent, manifold.sphere_starts
        self._logs, self._factor, self._goal = np.zeros((K, n, n)), np.eye(n), np.zeros(manifold.dim)

    @property
    def prepared(self) -> tuple[Array, Array]:
        """What `exponential` takes: the logarithms (K, n, n), and the factor (n, n) of the covariance at the goal."""
        return self._logs, self._factor

    def take(self, means: Array, covariances: Array, goal: Gaussian) -> bool:
        """Set the covariances.

        Parameters
        ----------
        means
            (K, D or more): where the covariances are; further dimensions do not count
        covariances
            (K, n or more, n or more), likewise
        goal
            the Gaussian that the others are seen by

        Returns
        -------
        False where a covariance is not positive definite
        """
        self._goal = np.array(goal.mean)
        at_goal = np.array(goal.covariance)
        return bool(
            logarithms(means, covariances, self._goal, at_goal, *self._layout, self._logs, self._factor)
        )  # fmt: skip

    def at(self, x: Array, weights: Array) -> Array:
        """The mean (n, n) at a point.

        Parameters
        ----------
        x
            (D,), the point that the mean is moved to
        weights
            (K,), of the covariances; what their sum lacks to 1 is the goal's

        Returns
        -------
        Array
            shape (n, n)
        """
        covariance = np.empty(self._factor.shape)
        exponential(x, weights, self._goal, *self._layout, self._logs, self._factor, covariance)
        return covariance


@compiled
def logarithms(
    means: Array, covariances: Array, goal: Array, at_goal: Array, flat: Array, spheres: Array, logs: Array,
    factor: Array,
) -> bool:  # fmt: skip
    """Logarithms of covariances, as the one at the goal sees them.

    Parameters
    ----------
    means, covariances
        of the components, (K, D) and (K, n, n)
    goal, at_goal
        mean (D,) and covariance (n, n) at the goal
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    logs
        (K, n, n), written
    factor
        (n, n), written: Cholesky factor of the covariance at the goal

    Returns
    -------
    bool
        False where a covariance is not positive definite
    """
    K, n, D = len(logs), len(flat), len(goal)
    C, L, back, half, e = np.empty((n, n)), np.zeros((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty(n)
    if not cholesky(at_goal, n, L):
        return False
    invert_lower(L, n, back)
    for i in range(n):
        for m in range(n):
            factor[i, m] = L[i, m] if m < i else 0.0
        factor[i, i] = 1.0 / L[i, i]  # the diagonal of L holds reciprocals
    for k in range(K):
        for i in range(n):
            for m in range(n):
                C[i, m] = covariances[k, i, m]
        if len(spheres) > 0:
            difference(goal, means[k, :D], flat, spheres, e)
            for s in range(len(spheres)):
                a = spheres[s, 1]
                transport(C, a, e[a], e[a + 1], e[a + 2])
        congruent(back, C, half)
        values, V = np.linalg.eigh(C)
        if not values[n - 1] > 0.0:
            return False
        for i in range(n):
            values[i] = math.log(max(values[i], SMALLEST * values[n - 1]))
        spectral(values, V, logs[k])
    return True


@compiled
def exponential(
    x: Array, weights: Array, goal: Array, flat: Array, spheres: Array, logs: Array, factor: Array, out: Array
) -> None:
    """Writes the mean with weights (K,), at x."""
    n = len(flat)
    total, half, e = np.zeros((n, n)), np.empty((n, n)), np.empty(n)
    for k in range(len(weights)):
        for i in range(n):
            for m in range(n):
                total[i, m] += weights[k] * logs[k, i, m]
    values, V = np.linalg.eigh(total)
    for i in range(n):
        values[i] = math.exp(values[i])
    spectral(values, V, out)
    congruent(factor, out, half)
    if len(spheres) > 0:
        difference(x, goal, flat, spheres, e)
        for s in range(len(spheres)):
            a = spheres[s, 1]
            transport(out, a, e[a], e[a + 1], e[a + 2])
        for i in range(n):
            for m in range(i):
                out[i, m] = out[m, i] = 0.5 * (out[i, m] + out[m, i])


@compiled
def spectral(values: Array, V: Array, out: Array) -> None:
    """Out = V diag(values) V^T."""
    n = len(values)
    for i in range(n):
        for m in range(i + 1):
            total = 0.0
            for c in range(n):
                total += values[c] * V[i, c] * V[m, c]
            out[i, m] = out[m, i] = total


@compiled
def congruent(F: Array, C: Array, half: Array) -> None:
    """C ← F C F^T, for F a lower triangle; half (n, n) is scratch."""
    n = len(C)
    for i in range(n):
        for m in range(n):
            total = 0.0
            for c in range(i + 1):
                total += F[i, c] * C[c, m]
            half[i, m] = total
    for i in range(n):
        for m in range(i + 1):
            total = 0.0
            for c in range(m + 1):
                total += half[i, c] * F[m, c]
            C[i, m] = C[m, i] = total
