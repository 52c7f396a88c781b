# SPDX-License-Identifier: Apache-2.0
"""Loops over the components of a trajectory model, compiled."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, invert_side_by_side


@compiled
def activate(log_priors: Array, times: Array, variances: Array, at: Array, activations: Array) -> None:
    """Activations of components in time: geometric means over the frames.

    Parameters
    ----------
    log_priors
        (K,)
    times, variances
        (P, K), when each frame saw a component, s, and how sure that is, s²
    at
        (T,), s
    activations
        (T, K), written: rows sum to 1
    """
    P, K = times.shape
    fixed = np.empty(K)
    for k in range(K):
        fixed[k] = log_priors[k]
        for j in range(P):
            fixed[k] -= 0.5 * math.log(variances[j, k]) / P
    for t in range(len(at)):
        top, total = -np.inf, 0.0
        for k in range(K):
            activations[t, k] = fixed[k]
            for j in range(P):
                apart = at[t] - times[j, k]
                activations[t, k] -= 0.5 * apart * apart / variances[j, k] / P
            top = max(top, activations[t, k])
        for k in range(K):
            activations[t, k] = math.exp(activations[t, k] - top)
            total += activations[t, k]
        for k in range(K):
            activations[t, k] /= total


@compiled
def precisions_without_time(covariances: Array, precisions: Array) -> None:
    """Precisions of all dimensions but the first one.

    Parameters
    ----------
    covariances
        (K, 1 + n, 1 + n)
    precisions
        (K, n, n), written; the trace is NaN or infinite where there is none
    """
    K, n = len(precisions), precisions.shape[1]
    S = np.empty((n, n, K))
    for k in range(K):
        for i in range(n):
            for m in range(i + 1):
                S[i, m, k] = covariances[k, 1 + i, 1 + m]
    invert_side_by_side(S, np.empty((n, n, K)), precisions)


@compiled
def least_cosine(one: Array, other: Array, first: int, spheres: Array) -> float:
    """Cosine of half the largest turn between the components of two mixtures; 1 on R^n.

    Parameters
    ----------
    one, other
        their means, (K, D)
    first
        ambient dimensions before the points that `spheres` is about
    spheres
        see `kernels_manifold`

    Returns
    -------
    float
        0 to 1
    """
    least = 1.0
    for k in range(len(one)):
        for s in range(len(spheres)):
            a, cosine = first + spheres[s, 0], 0.0
            for i in range(4):
                cosine += one[k, a + i] * other[k, a + i]
            least = min(least, abs(cosine))
    return least
