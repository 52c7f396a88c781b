# SPDX-License-Identifier: Apache-2.0
"""What conditioning a mixture needs of its components, compiled: slopes, and activations at the given values."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, exp_in_place, inlined, invert_lower
from tpgmm_core.geometry.kernels_moments import NEGLIGIBLE
from tpgmm_core.geometry.kernels_rotation import quaternion_difference

LOG_NEGLIGIBLE = math.log(NEGLIGIBLE)
SMALLEST = 2.2250738585072014e-308  # normal number: the logarithm of a prior is finite
LANES = 8  # of these, what loops take at once: ranges begin at a multiple of it


@compiled
def activate(
    values: Array, log_norms: Array, whitening: Array, means: Array, flat: Array, spheres: Array, wanted: bool,
    lanes: Array, z: Array, h: Array, active: Array,
) -> int:  # fmt: skip
    """Activations of values, and their whitened differences from the means.

    They are computed in logarithms; what is negligible everywhere is 0, if not wanted.

    Parameters
    ----------
    values
        (T, D_i)
    log_norms, whitening
        of the components, (K,) and (K, n_i, n_i)
    means
        (K, D_i)
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    wanted
        whether the activations of components that are negligible are wanted too
    lanes
        (4 + n_i, T), scratch
    z
        (K, n_i, T), written: the differences, side by side
    h
        (K, T), written: the activations, which sum to 1
    active
        (K, 3), written: components that are not negligible, and where they are so, the first and behind the last

    Returns
    -------
    int
        how many are active; 0 where no number says how far the values are from all components
    """
    K, n_i, size = len(means), len(flat), len(values)
    top, total, differences = lanes[0], lanes[1], lanes[4:]
    scratch, scale = lanes[2], lanes[3]
    for c in range(size):
        top[c] = -np.inf
    if n_i == 1 and len(spheres) == 0:  # as over time
        x = values.reshape(size)
        for k in range(K):
            f, m, norm = whitening[k, 0, 0], means[k, 0], log_norms[k]
            d, logarithm = z[k, 0], h[k]
            for c in range(size):
                d[c] = f * (x[c] - m)
                logarithm[c] = norm - 0.5 * d[c] * d[c]
                top[c] = max(top[c], logarithm[c])
    for k in range(K if n_i > 1 or len(spheres) > 0 else 0):
        given_differences(values, means[k], flat, spheres, differences)
        for i in range(n_i):
            f = whitening[k, i, 0]
            for c in range(size):
                z[k, i, c] = f * differences[0, c]
            for m in range(1, i + 1):
                f = whitening[k, i, m]
                for c in range(size):
                    z[k, i, c] += f * differences[m, c]
        f = log_norms[k]
        for c in range(size):
            h[k, c] = f - 0.5 * z[k, 0, c] * z[k, 0, c]
        for i in range(1, n_i):
            for c in range(size):
                h[k, c] -= 0.5 * z[k, i, c] * z[k, i, c]
        for c in range(size):
            top[c] = max(top[c], h[k, c])
    for c in range(size):
        if not top[c] > -np.inf:
            return 0
        total[c] = 0.0
    bits, n_active = scale.view(np.int64), 0
    for k in range(K):
        logarithm = h[k]
        for c in range(size):
            logarithm[c] -= top[c]
        begin, end = 0, size  # most components are active for a part of the values only
        if not wanted:
            while begin < size and all_negligible(logarithm, begin, min(begin + LANES, size)):
                begin += LANES
            end = -(-size // LANES) * LANES
            while end > begin and all_negligible(logarithm, end - LANES, min(end, size)):
                end -= LANES
            end = min(end, size)
            logarithm[:begin] = 0.0
            logarithm[end:size] = 0.0
        if begin < end:
            active[n_active, 0], active[n_active, 1], active[n_active, 2] = k, begin, end
            n_active += 1
            h_k, total_k = logarithm[begin:end], total[begin:end]
            exp_in_place(h_k, end - begin, scratch, bits, scale)
            for c in range(end - begin):
                total_k[c] += h_k[c]
    for c in range(size):
        total[c] = 1.0 / total[c]
    for j in range(n_active):
        k, begin, end = active[j]
        h_k, total_k = h[k, begin:end], total[begin:end]
        for c in range(end - begin):
            h_k[c] *= total_k[c]
    return n_active


@compiled
def all_negligible(logarithms: Array, begin: int, end: int) -> bool:
    """Tell whether no activation of a range is worth its time.

    Parameters
    ----------
    logarithms
        (T,)
    begin, end
        the range

    Returns
    -------
    bool
        all are below LOG_NEGLIGIBLE
    """
    several = 0
    for x in logarithms[begin:end]:  # counted, since that vectorises
        several += x >= LOG_NEGLIGIBLE
    return several == 0


@compiled
def factorise(
    priors: Array, covariances: Array, given: Array, free: Array, L: Array,
    log_norms: Array, whitening: Array, slopes: Array, within: Array,
) -> int:  # fmt: skip
    """What regression needs of all components.

    Parameters
    ----------
    priors, covariances
        of the mixture, (K,) and (K, n, n)
    given, free
        tangent indices, (n_i,) and (n_o,)
    L
        (n_i, n_i), scratch
    log_norms
        (K,), written: log densities at the means, without what all components share, and with the priors
    whitening
        (K, n_i, n_i), written: W, lower triangle, S_ii^-1 = W^T W
    slopes
        (K, n_i, n_o), written: V = W S_io; the conditional mean is V^T W d from the mean, for values d from the given
        mean
    within
        (K, n_o, n_o), written: S_oo - V^T V, the conditional covariances

    Returns
    -------
    int
        the first component whose covariance of what is given is singular, or -1
    """
    n_i, n_o = len(given), len(free)
    for k in range(len(priors)):
        for i in range(n_i):
            for m in range(i + 1):
                whitening[k, i, m] = covariances[k, given[i], given[m]]
        if not cholesky(whitening[k], n_i, L):
            return k
        invert_lower(L, n_i, whitening[k])
        log_norms[k] = math.log(max(priors[k], SMALLEST))
        for i in range(n_i):
            log_norms[k] += math.log(whitening[k, i, i])
            for o in range(n_o):
                slopes[k, i, o] = whitening[k, i, 0] * covariances[k, given[0], free[o]]
                for m in range(1, i + 1):
                    slopes[k, i, o] += whitening[k, i, m] * covariances[k, given[m], free[o]]
        for o in range(n_o):
            for m in range(o + 1):
                total = covariances[k, free[o], free[m]]
                for i in range(n_i):
                    total -= slopes[k, i, o] * slopes[k, i, m]
                within[k, o, m] = total
                within[k, m, o] = total
    return -1


@inlined
def given_differences(values: Array, mean: Array, flat: Array, spheres: Array, out: Array) -> None:
    """Tangent vectors from a mean to all values, side by side.

    Parameters
    ----------
    values
        (T, D_i)
    mean
        (D_i,)
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    out
        (n_i, T or more), written
    """
    for i in range(len(flat)):
        a = flat[i]
        if a >= 0:
            for c in range(len(values)):
                out[i, c] = values[c, a] - mean[a]
    for s in range(len(spheres)):
        a, t = spheres[s]
        for c in range(len(values)):
            out[t, c], out[t + 1, c], out[t + 2, c] = quaternion_difference(
                values[c, a], values[c, a + 1], values[c, a + 2], values[c, a + 3],
                mean[a], mean[a + 1], mean[a + 2], mean[a + 3],
            )  # fmt: skip
