# SPDX-License-Identifier: Apache-2.0
"""Moments of a mixture of conditional Gaussians, compiled: the last step of `kernels_condition.condition`."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import copy, copy_rows, inlined
from tpgmm_core.geometry.kernels_manifold import along, difference, longest, move
from tpgmm_core.geometry.kernels_product import MAX_STEPS
from tpgmm_core.geometry.kernels_rotation import quaternion_difference, rotation, turn

NEGLIGIBLE = 1e-20  # components with a smaller activation add nothing
MEAN_TOLERANCE = 1e-13  # the weighted mean on S³ stops at steps shorter than this, in rad
NEAR = math.cos(0.25 * math.pi)  # scalar product of quaternions that are a turn of pi / 2 apart


@inlined
def match_flat(
    active: Array, h: Array, means: Array, steps: Array, within: Array, start: int, size: int,
    out_means: Array, out_covariances: Array,
) -> None:  # fmt: skip
    """Moments on R^n of the active ones of K Gaussians.

    Parameters
    ----------
    active
        (A, 3), as `kernels_activation.activate` writes it
    h
        (K, size), weights, side by side
    means
        (K, n)
    steps
        (K, n, size), overwritten: the Gaussians lie at means + steps
    within
        (K, n, n), their covariances
    start, size
        the first value and the number of values
    out_means, out_covariances
        (n, T) and (n, n, T), written from `start` on
    """
    # unsigned: an index that might be negative, counted from the end, would keep the loops from vectorising
    n, first, stop = means.shape[1], np.uint64(start), np.uint64(start + size)
    for o in range(n):
        mean = out_means[o]
        for c in range(first, stop):
            mean[c] = 0.0
        for j in range(len(active)):
            k, begin, end = active[j, 0], np.uint64(active[j, 1]), np.uint64(active[j, 2])
            x, w, b = steps[k, o], h[k], means[k, o]
            for c in range(begin, end):
                x[c] += b
                mean[first + c] += w[c] * x[c]
        for j in range(len(active)):
            k, begin, end = active[j, 0], np.uint64(active[j, 1]), np.uint64(active[j, 2])
            x = steps[k, o]
            for c in range(begin, end):
                x[c] -= mean[first + c]
        for m in range(o + 1):
            total = out_covariances[o, m]
            for c in range(first, stop):
                total[c] = 0.0
            for j in range(len(active)):
                k, begin, end = active[j, 0], np.uint64(active[j, 1]), np.uint64(active[j, 2])
                w, e, f, C = h[k], steps[k, o], steps[k, m], within[k, o, m]
                for c in range(begin, end):
                    total[first + c] += w[c] * (C + e[c] * f[c])
            if m < o:
                other = out_covariances[m, o]
                for c in range(first, stop):
                    other[c] = total[c]


@inlined
def match_curved(
    h: Array, means: Array, steps: Array, within: Array, flat: Array, spheres: Array, mean: Array, covariance: Array
) -> None:
    """Moments of those of K Gaussians that are not negligible, where there are S³ factors.

    Parameters
    ----------
    h
        (K,), weights
    means
        (K, D)
    steps
        (K, n), tangent vectors from the means to where the Gaussians lie
    within
        (K, n, n), their covariances
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    mean, covariance
        (D,) and (n, n), written
    """
    n = len(flat)
    conditionals, e, step = means.copy(), np.empty((len(means), n)), np.empty(n)
    active, n_active, likeliest = np.empty(len(h), dtype=np.int64), 0, 0
    for k in range(len(h)):
        if h[k] < NEGLIGIBLE:
            continue
        active[n_active] = k
        n_active += 1
        for i in range(n):
            step[i] = steps[k, i]
        move(conditionals[k], step, flat, spheres)
        if h[k] > h[likeliest]:
            likeliest = k
    active = active[:n_active]
    copy(conditionals[likeliest], mean)
    for s in range(len(spheres)):
        a = spheres[s, 0]
        is_far = False
        for j in active:
            if abs(along(conditionals[j], mean, a)) < NEAR:
                is_far = True
        if is_far:  # there may be several means: the main axis of q q^T does not depend on signs, and lies near one
            moments = np.zeros((4, 4))
            for j in active:
                for i in range(4):
                    for m in range(4):
                        moments[i, m] += h[j] * conditionals[j, a + i] * conditionals[j, a + m]
            axes = np.linalg.eigh(moments)[1]
            for i in range(4):
                mean[a + i] = axes[i, 3]
    for _ in range(MAX_STEPS):
        step[:] = 0.0
        for j in active:
            difference(conditionals[j], mean, flat, spheres, e[j])
            for i in range(n):
                step[i] += h[j] * e[j, i]
        move(mean, step, flat, spheres)
        if longest(step) < MEAN_TOLERANCE:
            break
    covariance[:] = 0.0
    C, R, q = np.empty((n, n)), np.empty((3, 3)), np.empty(4)
    for j in active:
        difference(conditionals[j], mean, flat, spheres, e[j])
        copy_rows(within[j], C)
        for s in range(len(spheres)):
            a, t = spheres[s]
            # half the shortest turn from the component's mean to its conditional one, and from there to the mixture's
            x, y, z = quaternion_difference(
                conditionals[j, a], conditionals[j, a + 1], conditionals[j, a + 2], conditionals[j, a + 3],
                means[j, a], means[j, a + 1], means[j, a + 2], means[j, a + 3],
            )  # fmt: skip
            q[:] = 0.0
            q[3] = 1.0
            turn(q, 0.5 * x, 0.5 * y, 0.5 * z)
            turn(q, -0.5 * e[j, t], -0.5 * e[j, t + 1], -0.5 * e[j, t + 2])
            rotation(q[0], q[1], q[2], q[3], R)
            rotate(C, t, R)
        for i in range(n):
            for m in range(i + 1):
                covariance[i, m] += h[j] * (C[i, m] + e[j, i] * e[j, m])
    for i in range(n):
        for m in range(i):
            covariance[m, i] = covariance[i, m]


@inlined
def rotate(C: Array, t: int, R: Array) -> None:
    """C ← R C R^T for three of the dimensions.

    Parameters
    ----------
    C
        (n, n), changed
    t
        the first of the three
    R
        (3, 3)
    """
    n = len(C)
    for i in range(n):
        c0, c1, c2 = C[i, t], C[i, t + 1], C[i, t + 2]
        for m in range(3):
            C[i, t + m] = R[m, 0] * c0 + R[m, 1] * c1 + R[m, 2] * c2
    for i in range(n):
        c0, c1, c2 = C[t, i], C[t + 1, i], C[t + 2, i]
        for m in range(3):
            C[t + m, i] = R[m, 0] * c0 + R[m, 1] * c1 + R[m, 2] * c2
