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
from tpgmm_core.geometry.kernels import cholesky, compiled, exp_in_place, invert_lower, quaternion_difference
from tpgmm_core.geometry.kernels_moments import NEGLIGIBLE, match_curved, match_flat, match_one

LOG_NEGLIGIBLE = math.log(NEGLIGIBLE)
SMALLEST = 2.2250738585072014e-308  # normal number: the logarithm of a prior is finite
BLOCK = 256  # values side by side
LANES = 16  # of these, what loops take at once: ranges begin at a multiple of it

NOT_FINITE = -2  # what `condition` returns for values that are not numbers
TOO_FAR = -3  # and for values whose distance from all components is not finite


@compiled
def plan_parts(
    plan: Array,
) -> tuple[Array, Array, Array, Array, Array, Array, Array, Array]:
    """The arrays of a plan.

    Its first six numbers are how many tangent dimensions are given and free, n_i and n_o, ambient ones, D_i and D_o,
    and S³ factors, S_i and S_o. Then come tangent and ambient indices in the mixture of what is given (n_i,), (D_i,)
    and free (n_o,), (D_o,); then for both the arrangement `flat` and `spheres` of their own manifolds.
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
    """Regression at all values (T, D_i).

    Writes out_means, out_covariances, and out_activations (T, K), which sum to 1, or (0, K) where nobody asks for them.
    out_means (D_o, T) and out_covariances (n_o, n_o, T) on R^n, side by side as they are worked out, since to move
    them costs as much as to work them out; (T, D_o) and (T, n_o, n_o) where there are S³ factors.
    priors (K,), means (K, D), covariances (K, n, n): of the mixture. The Gaussians are moment-matched; on S³ the mean
    is where the weighted tangent vectors cancel out, and the components' covariances move there by parallel transport.
    Returns -1, NOT_FINITE, TOO_FAR, or the component whose covariance of the given dimensions is singular.
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
            if not math.isfinite(values[t, i]):
                return NOT_FINITE
    D_i, D_o, is_flat = len(given_ambient), len(free_ambient), len(free_spheres) == 0
    width = min(BLOCK, T)
    # one piece of memory, since each costs as much as many operations
    per_component = 1 + n_i * n_i + n_i * n_o + n_o * n_o + D_i + D_o
    room = np.empty(K * (per_component + width * (1 + n_i + n_o)) + width * (4 + n_i) + 2 * n_i * n_i)
    log_norms, room = room[:K], room[K:]
    whitening, room = room[: K * n_i * n_i].reshape(K, n_i, n_i), room[K * n_i * n_i :]
    slopes, room = room[: K * n_i * n_o].reshape(K, n_i, n_o), room[K * n_i * n_o :]
    within, room = room[: K * n_o * n_o].reshape(K, n_o, n_o), room[K * n_o * n_o :]
    given_means, room = room[: K * D_i].reshape(K, D_i), room[K * D_i :]
    free_means, room = room[: K * D_o].reshape(K, D_o), room[K * D_o :]
    h, room = room[: K * width].reshape(K, width), room[K * width :]
    z, room = room[: K * n_i * width].reshape(K, n_i, width), room[K * n_i * width :]
    steps, room = room[: K * n_o * width].reshape(K, n_o, width), room[K * n_o * width :]
    lanes, room = room[: (4 + n_i) * width].reshape(4 + n_i, width), room[(4 + n_i) * width :]
    scratch = room.reshape(2, n_i, n_i)
    active = np.empty((K, 3), dtype=np.int64)
    wanted = len(out_activations) > 0
    for k in range(K):
        if not factorise(covariances[k], given_tangent, free_tangent, scratch, whitening[k], slopes[k], within[k]):
            return k
        log_norms[k] = math.log(max(priors[k], SMALLEST))
        for i in range(n_i):
            log_norms[k] += math.log(whitening[k, i, i])
        for i in range(len(given_ambient)):
            given_means[k, i] = means[k, given_ambient[i]]
        for i in range(len(free_ambient)):
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
        if T == 1 and is_flat:
            match_one(h, z, free_means, slopes, within, steps, out_means, out_covariances)
            return -1
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
def activate(
    values: Array, log_norms: Array, whitening: Array, means: Array, flat: Array, spheres: Array, wanted: bool,
    lanes: Array, z: Array, h: Array, active: Array,
) -> int:  # fmt: skip
    """Activations h (K, T) of values (T, D_i), which sum to 1, and their whitened differences from the means (K, D_i).

    The differences are z (K, n_i, T), side by side. In logarithms; what is negligible everywhere is 0, if not wanted.

    active : (K, 3), written: components that are not negligible, and where they are so, the first and behind the last
    lanes : scratch (4 + n_i, T)

    Returns how many are active; 0 where no number says how far the values are from all components.
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
    """What regression needs of one component, from its covariance (n, n); False when what is given is singular there.

    whitening : W (n_i, n_i), lower triangle, S_ii^-1 = W^T W
    slopes : V = W S_io (n_i, n_o): the conditional mean is V^T W d from the mean, for values d from the given mean
    within : S_oo - V^T V (n_o, n_o), the conditional covariance
    scratch : (2, n_i, n_i)
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
    """Tangent vectors from the mean (D_i,) to all values (T, D_i), side by side: out (n_i, T or more)."""
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
