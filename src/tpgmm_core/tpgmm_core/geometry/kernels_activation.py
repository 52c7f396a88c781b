# SPDX-License-Identifier: Apache-2.0
"""What conditioning a mixture needs of its components, compiled: slopes, and activations at the given values."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, exp_in_place, invert_lower
from tpgmm_core.geometry.kernels_moments import NEGLIGIBLE
from tpgmm_core.geometry.kernels_rotation import quaternion_difference

LOG_NEGLIGIBLE = math.log(NEGLIGIBLE)
LANES = 16  # of these, what loops take at once: ranges begin at a multiple of it


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
            while begin < end and logarithm[begin] < LOG_NEGLIGIBLE:
                begin += 1
            while begin < end and logarithm[end - 1] < LOG_NEGLIGIBLE:
                end -= 1
            if begin < end:  # loops from a multiple of what the processor takes at once, and of as many
                begin, end = begin // LANES * LANES, min(-(-end // LANES) * LANES, size)
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
def factorise(
    covariance: Array, given: Array, free: Array, scratch: Array, whitening: Array, slopes: Array, within: Array
) -> bool:
    """What regression needs of one component.

    Parameters
    ----------
    covariance
        (n, n)
    given, free
        tangent indices, (n_i,) and (n_o,)
    scratch
        (2, n_i, n_i)
    whitening
        (n_i, n_i), written: W, lower triangle, S_ii^-1 = W^T W
    slopes
        (n_i, n_o), written: V = W S_io; the conditional mean is V^T W d from the mean, for values d from the given mean
    within
        (n_o, n_o), written: S_oo - V^T V, the conditional covariance

    Returns
    -------
    bool
        False when the covariance of what is given is singular
    """
    n_i, n_o = len(given), len(free)
    S, L = scratch
    for i in range(n_i):
        for m in range(i + 1):
            S[i, m] = covariance[given[i], given[m]]
    if not cholesky(S, n_i, L):
        return False
    invert_lower(L, n_i, whitening)
    for i in range(n_i):
        for o in range(n_o):
            slopes[i, o] = 0.0
            for m in range(i + 1):
                slopes[i, o] += whitening[i, m] * covariance[given[m], free[o]]
    for o in range(n_o):
        for m in range(o + 1):
            total = covariance[free[o], free[m]]
            for i in range(n_i):
                total -= slopes[i, o] * slopes[i, m]
            within[o, m] = total
            within[m, o] = total
    return True


@compiled
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
