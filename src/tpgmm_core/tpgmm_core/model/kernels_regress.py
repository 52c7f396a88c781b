# SPDX-License-Identifier: Apache-2.0
"""Gaussian mixture regression over time, compiled: on one mixture, and as each frame sees it.

`flat[i]` is the ambient index of tangent dimension i, or -1 on S³, and `spheres[s]` = (first ambient, first tangent
index) of each S³ factor: `Manifold.ambient_of_tangent` and `Manifold.sphere_starts`.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, copy_rows, gram, invert_lower
from tpgmm_core.geometry.kernels_manifold import difference, longest, move
from tpgmm_core.geometry.kernels_product import MAX_STEPS, STEP_TOLERANCE
from tpgmm_core.geometry.kernels_rotation import transport

NEGLIGIBLE = 1e-20  # components with a smaller activation add nothing


@compiled
def regress_given(
    activations: Array, means: Array, covariances: Array, t: float, flat: Array, spheres: Array, mean: Array,
    covariance: Array,
) -> None:  # fmt: skip
    """`regress` with given activations.

    Parameters
    ----------
    activations
        (K,), they sum to 1
    means, covariances, t, flat, spheres, mean, covariance
        of `regress`
    """
    K, D = means.shape
    n, likeliest, n_active, active = len(flat), 0, 0, np.empty(K, dtype=np.int64)
    for i in range(K):
        if activations[i] > activations[likeliest]:
            likeliest = i
        if not activations[i] < NEGLIGIBLE:  # also where they are no numbers
            active[n_active] = i
            n_active += 1
    active = active[:n_active]
    conditionals = means.copy()
    steps = np.empty((K, n))
    for k in active:
        slope = (t - means[k, 0]) / covariances[k, 0, 0]
        for i in range(n):
            steps[k, i] = covariances[k, i, 0] * slope
        move(conditionals[k], steps[k], flat, spheres)
    x = conditionals[likeliest].copy()
    e = np.empty((K, n))
    step = np.empty(n)
    for _ in range(MAX_STEPS):
        step[:] = 0.0
        for k in active:
            difference(conditionals[k], x, flat, spheres, e[k])
            for i in range(n):
                step[i] += activations[k] * e[k, i]
        move(x, step, flat, spheres)
        if len(spheres) == 0 or longest(step) < STEP_TOLERANCE:
            break
    for i in range(1, D):
        mean[i - 1] = x[i]
    covariance[:] = 0.0
    C = np.empty((n, n))
    for k in active:
        h = activations[k]
        difference(conditionals[k], x, flat, spheres, e[k])
        for i in range(n):
            gain = covariances[k, i, 0] / covariances[k, 0, 0]
            for m in range(i + 1):
                C[i, m] = covariances[k, i, m] - gain * covariances[k, m, 0]
                C[m, i] = C[i, m]
        for s in range(len(spheres)):
            a = spheres[s, 1]
            transport(C, a, steps[k, a], steps[k, a + 1], steps[k, a + 2])  # to the component's conditional mean
            transport(C, a, -e[k, a], -e[k, a + 1], -e[k, a + 2])  # and from there to the mixture's
        for i in range(1, n):
            for m in range(1, i + 1):
                covariance[i - 1, m - 1] += h * (C[i, m] + e[k, i] * e[k, m])
    for i in range(n - 1):
        for m in range(i):
            covariance[m, i] = covariance[i, m]


@compiled
def regress(
    log_priors: Array, means: Array, covariances: Array, t: float, flat: Array, spheres: Array, mean: Array,
    covariance: Array, activations: Array,
) -> None:  # fmt: skip
    """Gaussian mixture regression on the first dimension at t: mean (D - 1,), covariance (n - 1, n - 1).

    The Gaussian is moment-matched; on S³ its mean is where the weighted tangent vectors cancel out, and the
    components' covariances move there by parallel transport. activations (K,) sum to 1.
    """
    K = len(means)
    top = -np.inf
    for k in range(K):
        variance = covariances[k, 0, 0]
        d = t - means[k, 0]
        activations[k] = log_priors[k] - 0.5 * (math.log(variance) + d * d / variance)
        top = max(top, activations[k])
    total = 0.0
    for k in range(K):
        activations[k] = math.exp(activations[k] - top)
        total += activations[k]
    for k in range(K):
        activations[k] /= total
    regress_given(activations, means, covariances, t, flat, spheres, mean, covariance)


@compiled
def spread_at(
    activations: Array, means: Array, covariances: Array, times: Array, points: Array, flat: Array, spheres: Array,
    data_flat: Array, data_spheres: Array, out: Array,
) -> None:  # fmt: skip
    """Covariances of `regress_given` with activations (T, K) at times (T,), moved to the points (T, D - 1).

    data_flat, data_spheres: the layout without the first dimension. Writes out (T, n - 1, n - 1).
    """
    mean, e = np.empty(means.shape[1] - 1), np.empty(len(data_flat))
    for i in range(len(times)):
        regress_given(activations[i], means, covariances, times[i], flat, spheres, mean, out[i])
        difference(points[i], mean, data_flat, data_spheres, e)
        for s in range(len(data_spheres)):
            a = data_spheres[s, 1]
            transport(out[i], a, e[a], e[a + 1], e[a + 2])


@compiled
def regress_all(
    log_priors: Array, means: Array, covariances: Array, flat: Array, spheres: Array, times: Array,
    out_means: Array, out_covariances: Array, out_activations: Array,
) -> None:  # fmt: skip
    """`regress` at several times.

    Parameters
    ----------
    log_priors, means, covariances
        of the mixture, (K,), (K, D) and (K, n, n)
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    times
        (H,)
    out_means, out_covariances
        (H, D - 1) and (H, n - 1, n - 1), written
    out_activations
        (K,), written: at the first of the times
    """
    for i in range(len(times)):
        regress(
            log_priors, means, covariances, times[i], flat, spheres,
            out_means[i], out_covariances[i], out_activations[i],
        )  # fmt: skip


@compiled
def regress_views(
    log_priors: Array, means: Array, covariances: Array, sizes: Array, flat: Array, spheres: Array, weights: Array,
    times: Array, out_means: Array, out_precisions: Array, activations: Array,
) -> int:  # fmt: skip
    """Regression in each frame at all times, laid out for `kernels_adapt.adapt` as if the times were components.

    Parameters
    ----------
    log_priors
        (K,)
    means, covariances, sizes
        what each frame learned, time first: (P, K, D_max), (P, K, n_max, n_max) and (P, 2)
    flat, spheres
        arrangement of the manifold with time, see the module
    weights
        (P,), how far each frame is trusted
    times
        (H,)
    out_means, out_precisions
        (P, D_max - 1, H) and (P, n_max - 1, (n_max - 1) H), written for the frames with a weight
    activations
        (K,), written: at the first of the times, the mean over the frames

    Returns
    -------
    int
        -1, or the frame whose covariance is singular
    """
    (P, K), H = means.shape[:2], len(times)
    h, total = np.empty(K), 0.0
    activations[:] = 0.0
    for j in range(P):
        if not weights[j] > 0.0:
            continue
        D, n = sizes[j, 0] - 1, sizes[j, 1] - 1
        view_means, view_covariances = np.empty((K, D + 1)), np.empty((K, n + 1, n + 1))
        copy_rows(means[j, :, : D + 1], view_means)
        for k in range(K):
            copy_rows(covariances[j, k, : n + 1, : n + 1], view_covariances[k])
        mean, covariance, L = np.empty(D), np.empty((n, n)), np.empty((n, n))
        for i in range(H):
            regress(log_priors, view_means, view_covariances, times[i], flat[: n + 1], spheres, mean, covariance, h)
            if i == 0:
                total += weights[j]
                for k in range(K):
                    activations[k] += weights[j] * h[k]
            for o in range(D):
                out_means[j, o, i] = mean[o]
            if not lay_out_precision(covariance, L, i, H, out_precisions[j]):
                return j
    for k in range(K):
        activations[k] = activations[k] / total if total > 0.0 else math.exp(log_priors[k])
    return -1


@compiled
def lay_out_precision(covariance: Array, L: Array, i: int, H: int, out: Array) -> bool:
    """Write the inverse of a covariance as that of component i of H, as `kernels_adapt.adapt` takes it.

    Parameters
    ----------
    covariance
        (n, n); changed
    L
        (n, n), scratch
    i, H
        which component, and of how many
    out
        (n or more, n H or more), written

    Returns
    -------
    bool
        False where the covariance is not positive definite
    """
    n = len(covariance)
    if not cholesky(covariance, n, L):
        return False
    invert_lower(L, n, covariance)
    gram(covariance, n, L)
    for o in range(n):
        for m in range(n):
            out[o, m * H + i] = L[o, m]
    return True


@compiled
def time_changed(A: Array, b: Array, weights: Array) -> int:
    """Find a frame that changes time.

    Parameters
    ----------
    A, b
        of the frames, (P, D, D_max) and (P, D)
    weights
        (P,)

    Returns
    -------
    int
        the first frame with a weight that does not leave the first dimension as it is, or -1
    """
    for j in range(len(weights)):
        if not weights[j] > 0.0:
            continue
        mixed = abs(A[j, 0, 0] - 1.0) + abs(b[j, 0])
        for i in range(1, A.shape[1]):
            mixed += abs(A[j, i, 0])
        for m in range(1, A.shape[2]):
            mixed += abs(A[j, 0, m])
        if mixed > 0.0:
            return j
    return -1
