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

STEP_TOLERANCE = 1e-10  # Gauss-Newton on S³ stops at steps shorter than this
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
def add_term(
    x: Array, target: Array, precision: Array, flat: Array, spheres: Array, scratch: Array, gradient: Array,
    hessian: Array,
) -> float:  # fmt: skip
    """Add one term of Eq. (3), with its target and precision, at x: gradient (n,) and Gauss-Newton Hessian (n, n);
    returns half its cost.

    On S³ the error e = Log(x ⊗ target^-1) moves with x by the inverse left Jacobian J of SO(3).
    precision: lower triangle (n, n).
    """
    n = len(flat)
    e, force, J, B = scratch[0], scratch[1], scratch[2:5], scratch[5:]
    difference(x, target, flat, spheres, e)
    for i in range(n):
        for m in range(i + 1):
            B[i, m] = precision[i, m]
            B[m, i] = precision[i, m]
    cost = 0.0
    for i in range(n):
        force[i] = 0.0
        for m in range(n):
            force[i] += B[i, m] * e[m]
        cost += 0.5 * e[i] * force[i]
    for s in range(len(spheres)):
        t = spheres[s, 1]
        inverse_left_jacobian(e[t], e[t + 1], e[t + 2], J)
        for i in range(n):  # B ← B J
            b0, b1, b2 = B[i, t], B[i, t + 1], B[i, t + 2]
            for m in range(3):
                B[i, t + m] = b0 * J[0, m] + b1 * J[1, m] + b2 * J[2, m]
        for m in range(n):  # B ← J^T B
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
def scratch_for(n: int) -> Array:
    """Working memory of `add_term` and `invert_precision`."""
    return np.empty((5 + n, max(n, 3)))


@compiled
def invert_precision(
    H: Array, gradient: Array, x: Array, state: Array, min_precision: float, flat: Array,
    spheres: Array, scratch: Array, covariance: Array,
) -> float:  # fmt: skip
    """covariance = H^-1, where H is first filled up to min_precision by a term that holds what is free at the state.

    Returns the cost of that term.
    """
    n = len(flat)
    L = scratch[5:]
    if cholesky(H, n, L):
        invert_lower(L, n, covariance)
        # the Gram matrix overwrites the factor: entry (i, j) needs rows from max(i, j) on only
        gram(covariance, n, L)
        trace = 0.0
        for i in range(n):
            trace += L[i, i]
            for m in range(n):
                covariance[i, m] = L[i, m]
        if trace * min_precision < 1.0:  # then no eigenvalue of H lies below min_precision
            return 0.0
    values, vectors = np.linalg.eigh(H)
    # rounding of a large precision must not pass for information about the free directions
    lowest = max(min_precision, 1e-13 * values[-1])
    missing = (vectors * np.maximum(lowest - values, 0.0)) @ vectors.T
    cost = add_term(x, state, missing, flat, spheres, scratch, gradient, H)
    roots = vectors / np.sqrt(np.maximum(values, lowest))
    covariance[:] = roots @ roots.T
    return cost


@compiled
def fuse(
    targets: Array, precisions: Array, weights: Array, state: Array, min_precision: float, flat: Array, spheres: Array,
    mean: Array, covariance: Array,
) -> bool:  # fmt: skip
    """Product of Gaussians (Eqs. 3, 6) by Gauss-Newton steps, of which R^n needs one; False without convergence.

    targets (P, D), precisions (P, n, n) lower triangles; terms of weight 0 are left out. Steps that do not lower
    Eq. (3) are halved. Writes mean (D,) and covariance (n, n), the inverse Gauss-Newton Hessian there in fixed axes.
    """
    n = len(flat)
    gradient, H = np.empty(n), np.empty((n, n))
    step, scratch = np.zeros(n), scratch_for(n)
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
                cost += add_term(mean, targets[j], precisions[j], flat, spheres, scratch, gradient, H)
        cost += invert_precision(H, gradient, mean, state, min_precision, flat, spheres, scratch, covariance)
        if cost > former_cost * (1.0 + 1e-12) and longest(step) > STEP_TOLERANCE:
            for i in range(n):  # too far: half the way back
                step[i] *= -0.5
            move(mean, step, flat, spheres)
            for i in range(n):
                step[i] *= -1.0
            continue
        former_cost = cost
        for i in range(n):
            step[i] = 0.0
            for m in range(n):
                step[i] -= covariance[i, m] * gradient[m]
        move(mean, step, flat, spheres)
        if len(spheres) == 0 or longest(step) < STEP_TOLERANCE:
            return True
    return False
