# SPDX-License-Identifier: Apache-2.0
"""The E-step of a TP-GMM, compiled (Section 3 of the paper).

The samples of all frames are stacked as rows of one array X (D_1 + ... + D_P, N), so that the innermost
loops run over samples that lie side by side. Frame j is described by `layout[j]` = (first row, tangent
dimensions) and `flat[j, i]`, the row (from the first) of tangent dimension i, or -1 on S³; `spheres[s]` =
(frame, first row from the frame's first, first tangent dimension) of each S³ factor. Parameters: log_priors
(K,), means (K, D_1 + ... + D_P), covariances and inverse Cholesky factors (P, K, n, n) with n the largest
tangent dimension.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.constants import LOG_2PI, SINGULAR
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, copy, exp_in_place, invert_lower
from tpgmm_core.geometry.kernels_rotation import quaternion_difference

BLOCK = 256  # samples that are worked on together: large enough to vectorise, small enough for the cache
PART = 4 * BLOCK  # samples that are summed together; threads share parts, and the sums of parts are added in order
NEGLIGIBLE = 1e-20  # responsibilities below this, in a whole block, are left out of the sums


@compiled
def factorise(layout: Array, covariances: Array, factors: Array, log_norms: Array) -> int:
    """Inverse Cholesky factors and log normalisations of all covariances.

    Parameters
    ----------
    layout
        see the module
    covariances
        (P, K, n, n)
    factors
        (P, K, n, n), written
    log_norms
        (P, K), written

    Returns
    -------
    int
        -1, or K j + k for the first covariance, of frame j and component k, that is not positive definite, or is so by
        rounding alone
    """
    P, K = covariances.shape[:2]
    L = np.empty(covariances.shape[2:])
    for j in range(P):
        n = layout[j, 1]
        for k in range(K):
            if not cholesky(covariances[j, k], n, L):
                return K * j + k
            invert_lower(L, n, factors[j, k])
            log_norm = -0.5 * n * LOG_2PI
            for i in range(n):
                if SINGULAR * covariances[j, k, i, i] * factors[j, k, i, i] ** 2 >= 1.0:
                    return K * j + k
                log_norm += math.log(factors[j, k, i, i])
            log_norms[j, k] = log_norm
    return -1


@compiled
def differences(x: Array, size: int, mean: Array, j: int, layout: Array, flat: Array, spheres: Array, d: Array) -> None:
    """Tangent coordinates of samples at a mean.

    Parameters
    ----------
    x
        rows of the frame's samples, side by side
    size
        how many
    mean
        (D_j,)
    j
        the frame
    layout, flat, spheres
        see the module
    d
        (n, size or more), written: d[i, :size] is tangent coordinate i
    """
    first = layout[j, 0]
    for i in range(layout[j, 1]):
        if flat[j, i] >= 0:
            row = first + flat[j, i]
            m = mean[row]
            for b in range(size):
                d[i, b] = x[row, b] - m
    for s in range(len(spheres)):
        if spheres[s, 0] == j:
            r, i = first + spheres[s, 1], spheres[s, 2]
            for b in range(size):
                d[i, b], d[i + 1, b], d[i + 2, b] = quaternion_difference(
                    x[r, b], x[r + 1, b], x[r + 2, b], x[r + 3, b],
                    mean[r], mean[r + 1], mean[r + 2], mean[r + 3],
                )  # fmt: skip


@compiled
def add_log_densities(
    d: Array, n: int, size: int, F: Array, log_norm: float, seen: Array, y: Array, out: Array
) -> None:
    """out[:size] += seen * log N(d).

    Parameters
    ----------
    d
        (n, size or more), differences from the mean
    n
        tangent dimensions
    size
        how many samples
    F
        (n, n), inverse Cholesky factor of the covariance
    log_norm
        logarithm of what stands before the exponential
    seen
        (size or more,), 1, or 0 where the frame was not seen
    y
        (2, size or more), scratch
    out
        (size or more,), added to
    """
    whitened, quadratic = y[0], y[1]
    for b in range(size):
        quadratic[b] = 0.0
    for i in range(n):
        c = F[i, i]
        for b in range(size):
            whitened[b] = c * d[i, b]
        m = 0
        while m + 1 < i:
            c0, c1 = F[i, m], F[i, m + 1]
            for b in range(size):
                whitened[b] += c0 * d[m, b] + c1 * d[m + 1, b]
            m += 2
        if m < i:
            c = F[i, m]
            for b in range(size):
                whitened[b] += c * d[m, b]
        for b in range(size):
            quadratic[b] += whitened[b] * whitened[b]
    for b in range(size):
        out[b] += seen[b] * (log_norm - 0.5 * quadratic[b])


@compiled
def add_moments(d: Array, n: int, size: int, weights: Array, weighted: Array, first: Array, second: Array) -> float:
    """Add the weighted moments of differences.

    Parameters
    ----------
    d
        (n, size or more)
    n
        tangent dimensions
    size
        how many samples
    weights
        (size or more,)
    weighted
        (size or more,), scratch
    first, second
        (n,) and (n, n), lower triangle, added to

    Returns
    -------
    float
        the sum of the weights
    """
    weight = 0.0
    for b in range(size):
        weight += weights[b]
    for i in range(n):
        total = 0.0
        for b in range(size):
            weighted[b] = weights[b] * d[i, b]
            total += weighted[b]
        first[i] += total
        for m in range(i + 1):
            total = 0.0
            for b in range(size):
                total += weighted[b] * d[m, b]
            second[i, m] += total
    return weight


@compiled
def _expectation_of_part(
    X: Array, seen: Array, layout: Array, flat: Array, spheres: Array, log_priors: Array, means: Array,
    factors: Array, log_norms: Array, begin: int, end: int, counts: Array, first: Array, second: Array,
    responsibilities: Array,
) -> float:  # fmt: skip
    """E-step of the samples from begin to end, and the sums that the M-step needs of them; see `expectation`."""
    P, K = log_norms.shape
    x = np.empty((X.shape[0], BLOCK))
    s = np.ones((P, BLOCK))
    d = np.empty((first.shape[2], BLOCK))
    r = np.empty((K, BLOCK))
    y = np.empty((2, BLOCK))
    bits = np.empty(BLOCK, dtype=np.int64)
    scale = bits.view(np.float64)
    top = np.empty(BLOCK)
    weights = np.empty(BLOCK)
    counts[:] = 0.0
    first[:] = 0.0
    second[:] = 0.0
    log_likelihood = 0.0
    for start in range(begin, end, BLOCK):
        size = min(BLOCK, end - start)
        for row in range(len(X)):
            for b in range(size):
                x[row, b] = X[row, start + b]
        for j in range(P):
            for b in range(size):
                s[j, b] = seen[j, start + b]
        for k in range(K):
            for b in range(size):
                r[k, b] = log_priors[k]
            for j in range(P):
                differences(x, size, means[k], j, layout, flat, spheres, d)
                add_log_densities(d, layout[j, 1], size, factors[j, k], log_norms[j, k], s[j], y, r[k])
        for b in range(size):
            top[b] = r[0, b]
        for k in range(1, K):
            for b in range(size):
                top[b] = max(top[b], r[k, b])
        total = y[0]
        for b in range(size):
            total[b] = 0.0
        for k in range(K):
            for b in range(size):
                r[k, b] -= top[b]
            exp_in_place(r[k], size, y[1], bits, scale)
            for b in range(size):
                total[b] += r[k, b]
        for b in range(size):
            log_likelihood += top[b] + math.log(total[b])
            total[b] = 1.0 / total[b]
        for k in range(K):
            largest = 0.0
            for b in range(size):
                r[k, b] *= total[b]
                largest = max(largest, r[k, b])
            if len(spheres) > 0:
                for b in range(size):
                    responsibilities[k, start + b] = r[k, b]
            if largest < NEGLIGIBLE:
                continue
            for b in range(size):
                counts[P, k] += r[k, b]
            for j in range(P):
                for b in range(size):
                    weights[b] = r[k, b] * s[j, b]
                n = layout[j, 1]
                differences(x, size, means[k], j, layout, flat, spheres, d)
                counts[j, k] += add_moments(d, n, size, weights, y[1], first[j, k], second[j, k])
    return log_likelihood


@compiled
def expectation(
    X: Array, seen: Array, layout: Array, flat: Array, spheres: Array, log_priors: Array, means: Array,
    factors: Array, log_norms: Array, counts: Array, first: Array, second: Array, responsibilities: Array,
    log_likelihoods: Array, from_part: int, to_part: int,
) -> None:  # fmt: skip
    """E-step of some parts of the samples, PART each; it also sums the moments about the means for the M-step.

    Parts are independent of each other, so that several threads can work on them. `sum_parts` adds them in order:
    the result does not depend on the number of threads.

    Parameters
    ----------
    X
        samples
    seen
        which frames saw them
    layout, flat, spheres
        see the module
    log_priors, means, factors, log_norms
        of the components
    counts
        (S, P + 1, K), written for each part: weight per frame and, last, of all its samples
    first, second
        (S, P, K, n) and (S, P, K, n, n), lower triangles, written
    responsibilities
        (K, N), kept where there are S³ factors
    log_likelihoods
        (S,), written: the sum of the log-likelihoods of the part's samples
    from_part, to_part
        the parts to work on, the last one excluded
    """
    for part in range(from_part, to_part):
        log_likelihoods[part] = _expectation_of_part(
            X, seen, layout, flat, spheres, log_priors, means, factors, log_norms, part * PART,
            min((part + 1) * PART, X.shape[1]), counts[part], first[part], second[part], responsibilities,
        )  # fmt: skip


@compiled
def sum_parts(parts: Array, out: Array) -> None:
    """Add the sums of all parts, in order.

    Parameters
    ----------
    parts
        (S, M), one of the sums of `expectation`, for each part side by side
    out
        (M,), written
    """
    copy(parts[0], out)
    for part in range(1, len(parts)):
        for i in range(len(out)):
            out[i] += parts[part, i]
