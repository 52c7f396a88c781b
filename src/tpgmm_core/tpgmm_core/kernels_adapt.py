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
def multiply(F: Array, rows: Array, width: int, out: Array) -> None:
    """out[o, c] = sum over i of F[o, i] rows[i, c], for c < width."""
    n, count = F.shape
    for o in range(n):
        for c in range(width):
            out[o, c] = 0.0
        # four rows at once, since the rows are short; beyond the last one the factor is zero
        for i in range(0, count, 4):
            i1, i2, i3 = min(i + 1, count - 1), min(i + 2, count - 1), min(i + 3, count - 1)
            f0 = F[o, i]
            f1 = F[o, i1] if i + 1 < count else 0.0
            f2 = F[o, i2] if i + 2 < count else 0.0
            f3 = F[o, i3] if i + 3 < count else 0.0
            if f0 != 0.0 or f1 != 0.0 or f2 != 0.0 or f3 != 0.0:  # frames are full of zeros
                for c in range(width):
                    out[o, c] += f0 * rows[i, c] + f1 * rows[i1, c] + f2 * rows[i2, c] + f3 * rows[i3, c]


@compiled
def view_frame(
    means: Array, precisions: Array, size: Array, flat: Array, spheres: Array, A: Array, b: Array, weight: float,
    half: Array, turned: Array, targets: Array, terms: Array,
) -> bool:  # fmt: skip
    """Eq. (5) for one frame and all components; False when A does not fit the manifold.

    means (D_j, K); precisions (n_j, n_j K) of the model. Writes targets (D, K), A mu + b, and terms (n, n K),
    weight M^T Lambda_k M with M = A^+. half (n, n_j K) and turned (n_j, n K) are scratch.
    """
    D, K = targets.shape
    D_j, n_j = size
    n = len(flat)
    tangent = np.empty((n, n_j))
    if not tangent_matrix(A[:, :D_j], flat, spheres, tangent):
        return False
    M = np.ascontiguousarray(pseudo_inverse(tangent, RANK_TOLERANCE).T)
    multiply(M, precisions, n_j * K, half)
    for i in range(n):
        for m in range(n_j):
            for k in range(K):
                turned[m, i * K + k] = weight * half[i, m * K + k]
    multiply(M, turned, n * K, terms)
    multiply(A[:, :D_j], means, K, targets)
    for i in range(D):
        for k in range(K):
            targets[i, k] += b[i]
    return True


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
    means: Array, precisions: Array, sizes: Array, flat: Array, spheres: Array, A: Array, b: Array, weights: Array,
    state: Array, min_precision: float, out_means: Array, out_covariances: Array,
) -> int:  # fmt: skip
    """Eqs. (5) and (6) for all components; writes out_means (K, D) and out_covariances (K, n, n).

    means (P, D_max, K); precisions (P, n_max, n_max K), where entry (l, m) of component k lies at [l, m K + k];
    A (P, D, D_max), b (P, D), weights (P,), state (D,). Returns -1, or the frame whose matrix does not fit S³.
    """
    P, K = means.shape[0], means.shape[2]
    D, n = len(state), len(flat)
    half, turned = np.empty((n, precisions.shape[2])), np.empty((precisions.shape[1], n * K))
    targets, terms = np.empty((P, D, K)), np.empty((P, n, n * K))
    for j in range(P):
        if weights[j] > 0.0 and not view_frame(
            means[j], precisions[j], sizes[j], flat, spheres, A[j], b[j], weights[j],
            half, turned, targets[j], terms[j],
        ):  # fmt: skip
            return j
    if len(spheres) == 0:
        add_up(weights, targets, terms, state, min_precision, flat, spheres, out_means, out_covariances)
        return -1
    component_targets, component_terms = np.empty((P, D)), np.empty((P, n, n))
    for k in range(K):
        for j in range(P):
            for i in range(D):
                component_targets[j, i] = targets[j, i, k]
            for o in range(n):
                for i in range(o, n):
                    component_terms[j, i, o] = terms[j, o, i * K + k]
        fuse(
            component_targets, component_terms, weights, state, min_precision, flat, spheres,
            out_means[k], out_covariances[k],
        )  # fmt: skip
    return -1


@compiled
def add_up(
    weights: Array, targets: Array, terms: Array, state: Array, min_precision: float, flat: Array, spheres: Array,
    out_means: Array, out_covariances: Array,
) -> None:  # fmt: skip
    """Eq. (6) on R^n, for all components at once: precisions add up, means are weighted by them.

    targets (P, n, K) and terms (P, n, n K) as `view_frame` writes them. Sums are taken about one frame's means, so that
    a world far from its origin costs no digits.
    """
    P, n, K = targets.shape
    H, pull, base, d = np.zeros((n, n * K)), np.zeros((n, K)), np.empty((n, K)), np.empty((n, K))
    for i in range(n):
        base[i] = state[i]
    is_first = True
    for j in range(P):
        if not weights[j] > 0.0:
            continue
        for o in range(n):
            for c in range(n * K):
                H[o, c] += terms[j, o, c]
        if is_first:
            base[:] = targets[j]
            is_first = False
            continue
        for i in range(n):
            for k in range(K):
                d[i, k] = targets[j, i, k] - base[i, k]
        for o in range(n):
            for i in range(n):
                for k in range(K):
                    pull[o, k] += terms[j, o, i * K + k] * d[i, k]
    S, gradient, e, J, B = np.empty((n, n)), np.empty(n), np.empty((n, n)), np.empty((3, 3)), np.empty((n, n))
    for k in range(K):
        for o in range(n):
            gradient[o] = -pull[o, k]
            out_means[k, o] = base[o, k]
            for i in range(n):
                S[o, i] = H[o, i * K + k]
        invert_precision(S, gradient, out_means[k], state, min_precision, flat, spheres, e, J, B, out_covariances[k])
        for i in range(n):
            for m in range(n):
                out_means[k, i] -= out_covariances[k, i, m] * gradient[m]


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
def adapt_and_regress(
    means: Array, precisions: Array, sizes: Array, flat: Array, spheres: Array, A: Array, b: Array, weights: Array,
    state: Array, min_precision: float, adapted_means: Array, adapted_covariances: Array, log_priors: Array,
    times: Array, out_means: Array, out_covariances: Array, out_activations: Array,
) -> int:  # fmt: skip
    """`adapt`, then `regress` at all times (H,)."""
    failed: int = adapt(
        means, precisions, sizes, flat, spheres, A, b, weights, state, min_precision,
        adapted_means, adapted_covariances,
    )  # fmt: skip
    if failed < 0:
        for i in range(len(times)):
            regress(
                log_priors, adapted_means, adapted_covariances, times[i], flat, spheres,
                out_means[i], out_covariances[i], out_activations[i],
            )  # fmt: skip
    return failed
