# SPDX-License-Identifier: Apache-2.0
"""The product of Gaussians on R^n and S³ (Eqs. 3, 6), compiled.

`flat[i]` is the ambient index of tangent dimension i, or -1 on S³, and `spheres[s]` = (first ambient, first tangent
index) of each S³ factor: `Manifold.ambient_of_tangent` and `Manifold.sphere_starts`.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.kernels import (
    cholesky,
    compiled,
    gram,
    inverse_left_jacobian,
    invert_lower,
    quaternion_difference,
    turn,
)
from tpgmm_core.quaternion import Array

STEP_TOLERANCE = 1e-11  # Gauss-Newton on S³ stops at steps shorter than this
MAX_STEPS = 100


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
def move(x: Array, step: Array, flat: Array, spheres: Array) -> None:
    """x ← exp_x(step) in place."""
    for i in range(len(flat)):
        if flat[i] >= 0:
            x[flat[i]] += step[i]
    for s in range(len(spheres)):
        a, t = spheres[s]
        turn(x[a : a + 4], step[t], step[t + 1], step[t + 2])


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
    roots = vectors / np.sqrt(np.maximum(values, lowest))
    covariance[:] = roots @ roots.T
    return cost


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
