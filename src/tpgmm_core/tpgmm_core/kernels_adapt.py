# SPDX-License-Identifier: Apache-2.0
"""Adapting all components to new frames (Eqs. 5, 6) and regression over time, compiled.

Numbers of component k that are worked on together for all components lie side by side (component last), so
that the innermost loops vectorise. `spheres[s]` = (first ambient, first tangent index) of each S³ factor,
and `flat[i]` is the ambient index of tangent dimension i, or -1 on S³. Frame j takes `sizes[j]` = (D_j,
n_j) ambient and tangent dimensions to D and n.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.kernels import (
    RANK_TOLERANCE,
    cholesky,
    compiled,
    gram,
    inverse_left_jacobian,
    invert_lower,
    pseudo_inverse,
    quaternion_difference,
    rotation_of_left_matrix,
    transport,
    turn,
)
from tpgmm_core.quaternion import Array

STEP_TOLERANCE = 1e-11  # Gauss-Newton on S³ stops at steps shorter than this
MAX_STEPS = 100
NEGLIGIBLE = 1e-20  # components with a smaller activation add nothing to a covariance


@compiled
def tangent_matrix(A: Array, flat: Array, spheres: Array, out: Array) -> bool:
    """How A (D, D_j) acts on tangent vectors, out (n, n_j); False when a block on S³ is not L(q)."""
    if len(spheres) == 0:
        out[:] = A
        return True
    n = len(flat)
    for i in range(n):
        for m in range(n):
            out[i, m] = A[flat[i], flat[m]] if flat[i] >= 0 and flat[m] >= 0 else 0.0
    for s in range(len(spheres)):
        a, t = spheres[s]
        for i in range(A.shape[0]):
            if i < a or i >= a + 4:
                for m in range(a, a + 4):
                    if A[i, m] != 0.0 or A[m, i] != 0.0:
                        return False
        if not rotation_of_left_matrix(A[a : a + 4, a : a + 4], out[t : t + 3, t : t + 3]):
            return False
    return True


@compiled
def frame_precisions(M: Array, precisions: Array, K: int, weight: float, T: Array, out: Array) -> None:
    """out[i, o K + k] = weight (M^T Lambda_k M)[i, o] for all components, lower triangle.

    M = A^+ (n_j, n); precisions (n_j, n_j K) holds Lambda_k[l, m] at [l, m K + k]; T (n, n_j K) is scratch.
    """
    n_j, n = M.shape
    width = n_j * K
    for i in range(n):
        for c in range(width):
            T[i, c] = 0.0
        for m in range(n_j):
            factor = weight * M[m, i]
            if factor != 0.0:  # frames are full of zeros: time, position and orientation do not mix
                for c in range(width):
                    T[i, c] += factor * precisions[m, c]
        for o in range(i + 1):
            for k in range(K):
                out[i, o * K + k] = 0.0
            for m in range(n_j):
                factor = M[m, o]
                if factor != 0.0:
                    for k in range(K):
                        out[i, o * K + k] += factor * T[i, m * K + k]


@compiled
def difference(x: Array, base: Array, flat: Array, spheres: Array, out: Array) -> None:
    """out (n,) = log_base(x)."""
    for i in range(len(flat)):
        if flat[i] >= 0:
            out[i] = x[flat[i]] - base[flat[i]]
    for s in range(len(spheres)):
        a, t = spheres[s]
        out[t], out[t + 1], out[t + 2] = quaternion_difference(
            x[a], x[a + 1], x[a + 2], x[a + 3], base[a], base[a + 1], base[a + 2], base[a + 3]
        )


@compiled
def longest(step: Array) -> float:
    """Largest absolute entry."""
    result = 0.0
    for i in range(len(step)):
        result = max(result, abs(step[i]))
    return result


@compiled
def add_quadratic(
    x: Array, target: Array, precision: Array, flat: Array, spheres: Array, e: Array, J: Array, B: Array,
    gradient: Array, hessian: Array,
) -> float:  # fmt: skip
    """Add one term of Eq. (3), with its target and precision, at x: gradient and Gauss-Newton Hessian; half
    its cost.

    On S³ the error e = Log(x ⊗ target^-1) moves with x by the inverse left Jacobian J of SO(3).
    precision: lower triangle (n, n). e (n,), J (3, 3), B (n, n) are scratch.
    """
    n = len(flat)
    difference(x, target, flat, spheres, e)
    for i in range(n):
        for m in range(i + 1):
            B[i, m] = precision[i, m]
            B[m, i] = precision[i, m]
    cost = 0.0
    for i in range(n):
        total = 0.0
        for m in range(n):
            total += B[i, m] * e[m]
        cost += 0.5 * e[i] * total
    for s in range(len(spheres)):
        t = spheres[s, 1]
        inverse_left_jacobian(e[t], e[t + 1], e[t + 2], J)
        for i in range(n):  # columns: B ← B J
            b0, b1, b2 = B[i, t], B[i, t + 1], B[i, t + 2]
            for m in range(3):
                B[i, t + m] = b0 * J[0, m] + b1 * J[1, m] + b2 * J[2, m]
        for m in range(n):  # rows: B ← J^T B
            b0, b1, b2 = B[t, m], B[t + 1, m], B[t + 2, m]
            for i in range(3):
                B[t + i, m] = J[0, i] * b0 + J[1, i] * b1 + J[2, i] * b2
    # J e = e, since a turn about its own axis is a plain sum: hence J^T Lambda e = (J^T Lambda J) e
    for i in range(n):
        total = 0.0
        for m in range(n):
            total += B[i, m] * e[m]
            hessian[i, m] += B[i, m]
        gradient[i] += total
    return cost


@compiled
def invert_precision(
    H: Array, gradient: Array, x: Array, state: Array, min_precision: float, flat: Array, spheres: Array, e:
    Array, J: Array, B: Array, covariance: Array,
) -> float:  # fmt: skip
    """covariance = H^-1, where H is first filled up to min_precision by a term that holds what is free at
    the state.

    Returns the cost of that term. e, J and B are scratch.
    """
    n = len(flat)
    if cholesky(H, n, B):
        invert_lower(B, n, e)
        gram(e, n, covariance)
        trace = 0.0
        for i in range(n):
            trace += covariance[i, i]
        if trace * min_precision < 1.0:  # then no eigenvalue of H lies below min_precision
            return 0.0
    values, vectors = np.linalg.eigh(H)
    # rounding of a large precision must not pass for information about the free directions
    lowest = max(min_precision, 1e-13 * values[-1])
    missing = (vectors * np.maximum(lowest - values, 0.0)) @ vectors.T
    error = np.empty(n)
    cost = add_quadratic(x, state, missing, flat, spheres, error, J, B, gradient, H)
    values = np.maximum(values, lowest)
    covariance[:] = (vectors / values) @ vectors.T
    return cost


@compiled
def move(x: Array, step: Array, flat: Array, spheres: Array) -> None:
    """x ← exp_x(step) in place."""
    for i in range(len(flat)):
        if flat[i] >= 0:
            x[flat[i]] += step[i]
    for s in range(len(spheres)):
        a, t = spheres[s]
        turn(x[a : a + 4], step[t], step[t + 1], step[t + 2])


@compiled
def fuse(
    targets: Array, precisions: Array, weights: Array, state: Array, min_precision: float, flat: Array,
    spheres: Array, mean: Array, covariance: Array,
) -> bool:  # fmt: skip
    """Product of Gaussians (Eqs. 3, 6) by Gauss-Newton, which takes one step on R^n; False without
    convergence.

    targets (P, D), precisions (P, n, n) lower triangles; terms of weight 0 are left out. Writes mean (D,) and
    covariance (n, n), the inverse Hessian in fixed axes at the mean.
    """
    n = len(flat)
    gradient, step, e = np.empty(n), np.zeros(n), np.empty((n, n))
    H, B, J = np.empty((n, n)), np.empty((n, n)), np.empty((3, 3))
    # starting from the surest term keeps the residuals on S³ small
    surest = 0.0
    mean[:] = state
    for j in range(len(weights)):
        trace = 0.0
        for i in range(n):
            if flat[i] < 0 or len(spheres) == 0:
                trace += precisions[j, i, i]
        if weights[j] > 0.0 and trace > surest:
            surest = trace
            mean[:] = targets[j]
    former_cost = np.inf
    for _ in range(MAX_STEPS):
        gradient[:] = 0.0
        H[:] = 0.0
        cost = 0.0
        for j in range(len(weights)):
            if weights[j] > 0.0:
                cost += add_quadratic(mean, targets[j], precisions[j], flat, spheres, e[0], J, B, gradient, H)
        cost += invert_precision(H, gradient, mean, state, min_precision, flat, spheres, e, J, B, covariance)
        if cost > former_cost * (1.0 + 1e-12) and longest(step) > STEP_TOLERANCE:
            for i in range(n):  # too far: half the way back
                step[i] *= -0.5
            move(mean, step, flat, spheres)
            for i in range(n):
                step[i] *= -1.0
            continue
        former_cost = cost
        for i in range(n):
            total = 0.0
            for m in range(n):
                total -= covariance[i, m] * gradient[m]
            step[i] = total
        move(mean, step, flat, spheres)
        if len(spheres) == 0 or longest(step) < STEP_TOLERANCE:
            return True
    return False


@compiled
def adapt(
    means: Array, precisions: Array, sizes: Array, flat: Array, spheres: Array, A: Array, b: Array, weights:
    Array, state: Array, min_precision: float, out_means: Array, out_covariances: Array,
) -> int:  # fmt: skip
    """Eqs. (5) and (6) for all components; writes out_means (K, D) and out_covariances (K, n, n).

    means (P, D_max, K), precisions (P, n_max, n_max K) as in `frame_precisions`; A (P, D, D_max), b (P, D),
    weights (P,), state (D,). Returns -1, or -2 without convergence, or the frame whose matrix does not fit
    S³.
    """
    P, K = means.shape[0], means.shape[2]
    D, n = len(state), len(flat)
    n_max = precisions.shape[1]
    T = np.empty((n, n_max * K))
    spread = np.empty((n, n * K))
    targets = np.zeros((K, P, D))
    terms = np.zeros((K, P, n, n))
    for j in range(P):
        if not weights[j] > 0.0:
            continue
        D_j, n_j = sizes[j]
        tangent = np.empty((n, n_j))
        if not tangent_matrix(A[j, :, :D_j], flat, spheres, tangent):
            return j
        M = pseudo_inverse(tangent, RANK_TOLERANCE)
        frame_precisions(M, precisions[j], K, weights[j], T, spread)
        for i in range(n):
            for m in range(i + 1):
                for k in range(K):
                    terms[k, j, i, m] = spread[i, m * K + k]
        for i in range(D):
            for k in range(K):
                targets[k, j, i] = b[j, i]
            for m in range(D_j):
                if A[j, i, m] != 0.0:
                    for k in range(K):
                        targets[k, j, i] += A[j, i, m] * means[j, m, k]
    for k in range(K):
        if not fuse(
            targets[k],
            terms[k],
            weights,
            state,
            min_precision,
            flat,
            spheres,
            out_means[k],
            out_covariances[k],
        ):
            return -2
    return -1


@compiled
def regress(
    log_priors: Array, means: Array, covariances: Array, t: float, flat: Array, spheres: Array, mean: Array,
    covariance: Array, activations: Array,
) -> None:  # fmt: skip
    """Gaussian mixture regression on the first dimension at t: mean (D - 1,), covariance (n - 1, n - 1).

    The Gaussian is moment-matched; on S³ its mean is where the weighted tangent vectors cancel out, and the
    components' covariances move there by parallel transport. activations (K,) sum to 1.
    """
    K, D = means.shape
    n = len(flat)
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
    likeliest = 0
    for k in range(K):
        activations[k] /= total
        if activations[k] > activations[likeliest]:
            likeliest = k
    conditionals = means.copy()
    steps = np.empty((K, n))
    for k in range(K):
        slope = (t - means[k, 0]) / covariances[k, 0, 0]
        for i in range(n):
            steps[k, i] = covariances[k, i, 0] * slope
        move(conditionals[k], steps[k], flat, spheres)
    x = conditionals[likeliest].copy()
    e = np.empty((K, n))
    step = np.empty(n)
    for _ in range(MAX_STEPS):
        step[:] = 0.0
        for k in range(K):
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
    for k in range(K):
        h = activations[k]
        if h < NEGLIGIBLE:
            continue
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
            for m in range(1, n):
                covariance[i - 1, m - 1] += h * (C[i, m] + e[k, i] * e[k, m])


@compiled
def regress_all(
    log_priors: Array, means: Array, covariances: Array, times: Array, flat: Array, spheres: Array,
    out_means: Array, out_covariances: Array, out_activations: Array,
) -> None:  # fmt: skip
    """`regress` at all times (H,)."""
    for i in range(len(times)):
        regress(
            log_priors,
            means,
            covariances,
            times[i],
            flat,
            spheres,
            out_means[i],
            out_covariances[i],
            out_activations[i],
        )
