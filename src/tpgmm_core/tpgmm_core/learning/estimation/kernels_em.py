# SPDX-License-Identifier: Apache-2.0
"""The M-step of a TP-GMM, compiled (Section 3 of the paper).

Samples and parameters are arranged as in `kernels_expectation`.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.kernels_rotation import turn
from tpgmm_core.learning.estimation.kernels_expectation import BLOCK, NEGLIGIBLE, PART, add_moments, differences

EMPTY = 1e-12  # a component with fewer samples than this keeps its Gaussian


@compiled
def moments_about(
    X: Array, seen: Array, layout: Array, flat: Array, spheres: Array, means: Array, responsibilities: Array,
    first: Array, second: Array, from_part: int, to_part: int,
) -> None:  # fmt: skip
    """Sum the moments of some parts of the samples about other means than those of the E-step.

    For S³, where a shift of the tangent space is more than a subtraction. Parts are those of `expectation`.

    Parameters
    ----------
    X
        samples
    seen
        which frames saw them
    layout, flat, spheres
        see `kernels_expectation`
    means
        (K, D_1 + ... + D_P)
    responsibilities
        (K, N)
    first, second
        (S, P, K, n) and (S, P, K, n, n), lower triangles, written for each part
    from_part, to_part
        the parts to work on, the last one excluded
    """
    P, K, n = first.shape[1:]
    d = np.empty((n, BLOCK))
    weights, weighted = np.empty(BLOCK), np.empty(BLOCK)
    for part in range(from_part, to_part):
        first[part] = 0.0
        second[part] = 0.0
        end = min((part + 1) * PART, X.shape[1])
        for start in range(part * PART, end, BLOCK):
            size = min(BLOCK, end - start)
            x = X[:, start : start + size].copy()
            for k in range(K):
                if responsibilities[k, start : start + size].max() < NEGLIGIBLE:
                    continue
                for j in range(P):
                    for b in range(size):
                        weights[b] = responsibilities[k, start + b] * seen[j, start + b]
                    differences(x, size, means[k], j, layout, flat, spheres, d)
                    add_moments(d, layout[j, 1], size, weights, weighted, first[part, j, k], second[part, j, k])


@compiled
def move_means(layout: Array, flat: Array, spheres: Array, means: Array, counts: Array, first: Array) -> None:
    """Move every mean by its mean difference first / counts, along the manifold.

    Parameters
    ----------
    layout, flat, spheres
        see the module
    means
        (K, D_1 + ... + D_P), changed
    counts, first
        of `expectation`
    """
    P, K = first.shape[:2]
    for j in range(P):
        for k in range(K):
            if counts[j, k] > EMPTY:
                for i in range(layout[j, 1]):
                    if flat[j, i] >= 0:
                        means[k, layout[j, 0] + flat[j, i]] += first[j, k, i] / counts[j, k]
                for s in range(len(spheres)):
                    if spheres[s, 0] == j:
                        row, i = layout[j, 0] + spheres[s, 1], spheres[s, 2]
                        w = first[j, k, i : i + 3] / counts[j, k]
                        turn(means[k, row : row + 4], w[0], w[1], w[2])


@compiled
def maximisation(
    layout: Array, flat: Array, spheres: Array, log_priors: Array, means: Array, covariances: Array, counts: Array,
    first: Array, second: Array, added: float, prior_count: float, prior_scatters: Array,
) -> None:  # fmt: skip
    """M-step from the moments: priors, means, and covariances.

    These are (scatter + prior scatter) / (count + prior_count) + added I.

    Components without samples, in all or in one frame, keep their Gaussian.

    Parameters
    ----------
    layout, flat, spheres
        see the module
    log_priors, means, covariances
        of the components, changed
    counts, first, second
        of `expectation`
    added, prior_count, prior_scatters
        the regularisation; scatters are (P, K, n, n)
    """
    P, K = first.shape[:2]
    total = 0.0
    for k in range(K):
        total += counts[P, k]
    for k in range(K):
        log_priors[k] = math.log(max(counts[P, k] / total, 1e-300))
    move_means(layout, flat, spheres, means, counts, first)
    for j in range(P):
        n = layout[j, 1]
        for k in range(K):
            count = counts[j, k]
            if count > EMPTY:
                for i in range(n):
                    for m in range(i + 1):
                        value = second[j, k, i, m] - first[j, k, i] * first[j, k, m] / count
                        value = (value + prior_scatters[j, k, i, m]) / (count + prior_count)
                        covariances[j, k, i, m] = value
                        covariances[j, k, m, i] = value
                    covariances[j, k, i, i] += added


@compiled
def prior_penalty(layout: Array, factors: Array, prior_count: float, prior_scatters: Array) -> float:
    """-log of the prior of all covariances, without its constant.

    Parameters
    ----------
    layout
        (P, 2), first row and tangent dimensions of each frame
    factors
        (P, K, n, n), inverse Cholesky factors of the covariances
    prior_count
        samples that are taken to have been seen before
    prior_scatters
        (P, K, n, n), the sums of their outer products

    Returns
    -------
    float
        half the sum of prior_count log|Sigma| + tr(prior scatter Sigma^-1)
    """
    P, K = factors.shape[:2]
    total = 0.0
    for j in range(P):
        n = layout[j, 1]
        for k in range(K):
            F, scatter = factors[j, k], prior_scatters[j, k]
            for i in range(n):
                total -= 2.0 * prior_count * math.log(F[i, i])
                for m in range(i + 1):
                    if F[i, m] != 0.0:
                        share = 0.0
                        for o in range(i + 1):
                            share += scatter[m, o] * F[i, o]
                        total += F[i, m] * share
    return 0.5 * total
