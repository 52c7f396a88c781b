# SPDX-License-Identifier: Apache-2.0
"""Gaussian mixture regression (GMR), compiled: the Gaussian of some dimensions, given values of the others.

A `plan` says which dimensions are given and which are free (see `plan_parts`). What does not depend on the values
(factors, slopes, conditional covariances) is worked out once per component; then values are taken in blocks, side by
side, so that the innermost loops vectorise.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, inlined, is_finite
from tpgmm_core.geometry.kernels_activation import SMALLEST, activate, factorise
from tpgmm_core.geometry.kernels_moments import NEGLIGIBLE, match_curved, match_flat

BLOCK = 256  # values side by side

NOT_FINITE = -2  # what `condition` returns for values that are not numbers
TOO_FAR = -3  # and for values whose distance from all components is not finite


@inlined
def plan_parts(
    plan: Array,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array]:
    """The arrays of a plan.

    Its first six numbers are how many tangent dimensions are given and free, n_i and n_o, ambient ones, D_i and D_o,
    and S³ factors, S_i and S_o.

    Parameters
    ----------
    plan
        of `split`

    Returns
    -------
    tuple[Array, Array, Array, Array, Array, Array, Array, Array]
        tangent and ambient indices in the mixture of what is given, (n_i,) and (D_i,), and free, (n_o,) and (D_o,);
        then for both the arrangement `flat` and `spheres` of their own manifolds
    """
    n_i, n_o, D_i, D_o, S_i, S_o = plan[0], plan[1], plan[2], plan[3], plan[4], plan[5]
    a = 6
    given_tangent = plan[a : a + n_i]
    a += n_i
    free_tangent = plan[a : a + n_o]
    a += n_o
    given_ambient = plan[a : a + D_i]
    a += D_i
    free_ambient = plan[a : a + D_o]
    a += D_o
    given_flat = plan[a : a + n_i]
    a += n_i
    free_flat = plan[a : a + n_o]
    a += n_o
    given_spheres = plan[a : a + 2 * S_i].reshape(S_i, 2)
    a += 2 * S_i
    free_spheres = plan[a : a + 2 * S_o].reshape(S_o, 2)
    return (
        given_tangent, free_tangent, given_ambient, free_ambient, given_flat, free_flat, given_spheres, free_spheres
    )  # fmt: skip


@compiled
def condition(
    priors: Array, means: Array, covariances: Array, plan: Array, values: Array, out_means: Array,
    out_covariances: Array, out_activations: Array,
) -> int:  # fmt: skip
    """Regression at all values.

    The Gaussians are moment-matched; on S³ the mean is where the weighted tangent vectors cancel out, and the
    components' covariances move there by parallel transport.

    Parameters
    ----------
    priors, means, covariances
        of the mixture, (K,), (K, D) and (K, n, n)
    plan
        see `plan_parts`
    values
        (T, D_i)
    out_means, out_covariances
        written: (D_o, T) and (n_o, n_o, T) on R^n, side by side as they are worked out, since to move them costs as
        much as to work them out; (T, D_o) and (T, n_o, n_o) where there are S³ factors
    out_activations
        (T, K), written, rows sum to 1; (0, K) where nobody asks for them

    Returns
    -------
    int
        -1, NOT_FINITE, TOO_FAR, or the component whose covariance of the given dimensions is singular
    """
    given_tangent, free_tangent, given_ambient, free_ambient, given_flat, free_flat, given_spheres, free_spheres = (
        plan_parts(plan)
    )
    K, T = len(priors), len(values)
    n_i, n_o = len(given_tangent), len(free_tangent)
    if T == 0:
        return -1
    for t in range(T):
        for i in range(values.shape[1]):
            if not is_finite(values[t, i]):
                return NOT_FINITE
    D_i, D_o, is_flat = len(given_ambient), len(free_ambient), len(free_spheres) == 0
    width = min(BLOCK, T)
    # Few pieces of memory, since each costs as much as many operations. What loops over the values write has pieces of
    # its own: these loops vectorise only where the compiler knows that they do not overlap.
    room = np.empty(K * (1 + n_i * n_i + n_i * n_o + n_o * n_o + D_i + D_o) + n_i * n_i)
    log_norms, room = room[:K], room[K:]
    whitening, room = room[: K * n_i * n_i].reshape(K, n_i, n_i), room[K * n_i * n_i :]
    slopes, room = room[: K * n_i * n_o].reshape(K, n_i, n_o), room[K * n_i * n_o :]
    within, room = room[: K * n_o * n_o].reshape(K, n_o, n_o), room[K * n_o * n_o :]
    given_means, room = room[: K * D_i].reshape(K, D_i), room[K * D_i :]
    free_means, room = room[: K * D_o].reshape(K, D_o), room[K * D_o :]
    lanes, h, z, steps = (
        np.empty((4 + n_i, width)), np.empty((K, width)), np.empty((K, n_i, width)), np.empty((K, n_o, width))
    )  # fmt: skip
    active = np.empty((K, 3), dtype=np.int64)
    wanted = len(out_activations) > 0
    failed = factorise(
        priors, covariances, given_tangent, free_tangent, room.reshape(n_i, n_i), log_norms, whitening, slopes, within
    )
    if failed != -1:
        return failed
    for k in range(K):
        for i in range(D_i):
            given_means[k, i] = means[k, given_ambient[i]]
        for i in range(D_o):
            free_means[k, i] = means[k, free_ambient[i]]
    for start in range(0, T, width):
        size = min(width, T - start)
        block = values[start : start + size]
        n_active = activate(
            block, log_norms, whitening, given_means, given_flat, given_spheres, wanted, lanes, z, h, active
        )
        if n_active == 0:
            return TOO_FAR
        if wanted:
            for k in range(K):
                for c in range(size):
                    out_activations[start + c, k] = h[k, c]
        for j in range(n_active):
            k, begin, end = active[j]
            for o in range(n_o):  # how far the conditional mean is from the component's
                step = steps[k, o, begin:end]
                step[:] = 0.0
                for i in range(n_i):
                    slope, w = slopes[k, i, o], z[k, i, begin:end]
                    for c in range(len(step)):
                        step[c] += slope * w[c]
        if is_flat:
            match_flat(active[:n_active], h, free_means, steps, within, start, size, out_means, out_covariances)
        else:
            for c in range(size):
                match_curved(
                    h[:, c], free_means, steps[:, :, c], within, free_flat, free_spheres,
                    out_means[start + c], out_covariances[start + c],
                )  # fmt: skip
    return -1


@compiled
def condition_one(
    priors: Array, means: Array, covariances: Array, plan: Array, value: Array, out_mean: Array, out_covariance: Array
) -> int:
    """`condition` on R^n for one value, without what it takes to have several side by side: a third of its time.

    Parameters
    ----------
    priors, means, covariances, plan
        as for `condition`, without S³ factors
    value
        (D_i,)
    out_mean, out_covariance
        (n_o,) and (n_o, n_o), written

    Returns
    -------
    int
        as of `condition`
    """
    K, n_i, n = len(priors), plan[0], plan[1]
    given, free = plan[6 : 6 + n_i], plan[6 + n_i : 6 + n_i + n]
    for i in range(n_i):
        if not is_finite(value[i]):
            return NOT_FINITE
    room = np.empty(K * (1 + n + n_i * n) + n_i * (1 + 2 * n_i))
    h, room = room[:K], room[K:]
    x, room = room[: K * n].reshape(K, n), room[K * n :]
    slopes, room = room[: K * n_i * n].reshape(K, n_i, n), room[K * n_i * n :]
    z, room = room[:n_i], room[n_i:]
    S, L = room.reshape(2, n_i, n_i)
    top, total = -np.inf, 0.0
    for k in range(K):
        for i in range(n_i):
            for m in range(i + 1):
                S[i, m] = covariances[k, given[i], given[m]]
        if not cholesky(S, n_i, L):
            return k
        h[k] = math.log(max(priors[k], SMALLEST))
        for i in range(n_i):  # z = L^-1 d, slopes = L^-1 S_io
            z[i] = value[i] - means[k, given[i]]
            for m in range(i):
                z[i] -= L[i, m] * z[m]
            z[i] *= L[i, i]
            h[k] += math.log(L[i, i]) - 0.5 * z[i] * z[i]
        for o in range(n):
            x[k, o] = means[k, free[o]]
            for i in range(n_i):
                slopes[k, i, o] = covariances[k, given[i], free[o]]
                for m in range(i):
                    slopes[k, i, o] -= L[i, m] * slopes[k, m, o]
                slopes[k, i, o] *= L[i, i]
                x[k, o] += slopes[k, i, o] * z[i]
        top = max(top, h[k])
    if not top > -np.inf:
        return TOO_FAR
    for k in range(K):
        h[k] = math.exp(h[k] - top)
        total += h[k]
    out_mean[:] = 0.0
    out_covariance[:] = 0.0
    for k in range(K):
        h[k] /= total
        for o in range(n if h[k] >= NEGLIGIBLE else 0):
            out_mean[o] += h[k] * x[k, o]
    for k in range(K):
        for o in range(n if h[k] >= NEGLIGIBLE else 0):
            e = x[k, o] - out_mean[o]
            for m in range(o + 1):
                C = covariances[k, free[o], free[m]] + e * (x[k, m] - out_mean[m])
                for i in range(n_i):
                    C -= slopes[k, i, o] * slopes[k, i, m]
                out_covariance[o, m] += h[k] * C
    for o in range(n):
        for m in range(o):
            out_covariance[m, o] = out_covariance[o, m]
    return -1
