# SPDX-License-Identifier: Apache-2.0
"""One EM iteration of a TP-GMM, compiled (Section 3 of the paper).

Samples and parameters are arranged as in `kernels_expectation`.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.kernels_rotation import turn
from tpgmm_core.learning.estimation.kernels_expectation import (
    BLOCK,
    NEGLIGIBLE,
    add_moments,
    differences,
    expectation,
    factorise,
)

EMPTY = 1e-12  # a component with fewer samples than this keeps its Gaussian


@compiled
def recentre(
    X: Array, seen: Array, layout: Array, flat: Array, spheres: Array, means: Array, counts: Array,
    first: Array, second: Array, responsibilities: Array,
) -> None:  # fmt: skip
    """Move the means by the first moments and compute the moments about the new means.

    For S³, where a shift of the tangent space is more than a subtraction.

    Parameters
    ----------
    X
        samples
    seen
        which frames saw them
    layout, flat, spheres
        see the module
    means
        (K, D_1 + ... + D_P), changed
    counts, first, second
        of `expectation`; changed
    responsibilities
        (K, N)
    """
    P, K = first.shape[:2]
    N = X.shape[1]
    move_means(layout, flat, spheres, means, counts, first)
    first[:] = 0.0
    second[:] = 0.0
    d = np.empty((first.shape[2], BLOCK))
    weights, weighted = np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, N, BLOCK):
        size = min(BLOCK, N - start)
        x = X[:, start : start + size].copy()
        for k in range(K):
            if responsibilities[k, start : start + size].max() < NEGLIGIBLE:
                continue
            for j in range(P):
                for b in range(size):
                    weights[b] = responsibilities[k, start + b] * seen[j, start + b]
                differences(x, size, means[k], j, layout, flat, spheres, d)
                add_moments(d, layout[j, 1], size, weights, weighted, first[j, k], second[j, k])


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


@compiled
def em_iteration(
    X: Array, seen: Array, layout: Array, flat: Array, spheres: Array, log_priors: Array, means: Array,
    covariances: Array, factors: Array, log_norms: Array, counts: Array, first: Array, second: Array,
    responsibilities: Array, added: float, prior_count: float, prior_scatters: Array,
) -> tuple[float, float, int]:  # fmt: skip
    """One EM iteration in place: E-step, then M-step, then the factors of the new covariances.

    Parameters
    ----------
    X
        samples
    seen
        which frames saw them
    layout, flat, spheres
        see the module
    log_priors, means, covariances, factors, log_norms
        of the components, changed
    counts, first, second, responsibilities
        scratch, of `expectation`
    added, prior_count, prior_scatters
        the regularisation; the log of the prior is -1/2 (prior_count log|Sigma| + tr(prior scatter Sigma^-1)), summed
        over the covariances

    Returns
    -------
    tuple[float, float, int]
        the log-likelihood and the penalised log-likelihood per sample, both before the M-step, and what `factorise`
        returns
    """
    N = X.shape[1]
    log_likelihood = expectation(
        X,
        seen,
        layout,
        flat,
        spheres,
        log_priors,
        means,
        factors,
        log_norms,
        counts,
        first,
        second,
        responsibilities,
    )
    penalty = prior_penalty(layout, factors, prior_count, prior_scatters)
    if len(spheres) > 0:
        recentre(X, seen, layout, flat, spheres, means, counts, first, second, responsibilities)
    maximisation(
        layout, flat, spheres, log_priors, means, covariances, counts, first, second, added, prior_count, prior_scatters
    )  # fmt: skip
    failed = factorise(layout, covariances, factors, log_norms)
    return log_likelihood / N, (log_likelihood - penalty) / N, failed
