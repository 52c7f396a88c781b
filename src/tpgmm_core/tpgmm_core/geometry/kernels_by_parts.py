# SPDX-License-Identifier: Apache-2.0
"""Gauss-Newton steps of a product of Gaussians on R^n and S³ (Eq. 3), by parts, compiled.

Errors in R^n are linear, so that this part of the Hessian stays what it is while the search goes on. With the
dimensions of R^n first and those of S³ last, the first rows of its Cholesky factor stay too: a step adds the last rows
alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, gram, inlined, invert_lower
from tpgmm_core.geometry.kernels_rotation import inverse_left_jacobian


@inlined
def sort_dimensions(flat: Array, spheres: Array) -> NDArray[np.int64]:
    """The tangent dimensions, those of R^n first.

    Parameters
    ----------
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`

    Returns
    -------
    NDArray[np.int64]
        (n,)
    """
    n = len(flat)
    order, count = np.empty(n, dtype=np.int64), 0
    for i in range(n):
        if flat[i] >= 0:
            order[count] = i
            count += 1
    for s in range(len(spheres)):
        for i in range(3):
            order[count] = spheres[s, 1] + i
            count += 1
    return order


@inlined
def sort_terms(precisions: Array, weights: Array, order: Array, rest: int, out: Array, L: Array) -> bool:
    """Put the terms' precisions into an order, and factorise the part of their sum that stays.

    Parameters
    ----------
    precisions
        (P, n, n), lower triangles
    weights
        (P,); terms of weight 0 are left out
    order
        of `sort_dimensions`
    rest
        number of dimensions of R^n
    out
        (P, n, n), written, symmetric
    L
        (n, n), its first `rest` rows written, as by `cholesky`

    Returns
    -------
    bool
        False where the sum is not positive definite
    """
    n = len(order)
    H = np.zeros((rest, rest))
    for j in range(len(weights)):
        if not weights[j] > 0.0:
            continue
        for i in range(n):
            for m in range(i + 1):
                r, c = max(order[i], order[m]), min(order[i], order[m])
                out[j, i, m] = precisions[j, r, c]
                out[j, m, i] = precisions[j, r, c]
        for i in range(rest):
            for m in range(i + 1):
                H[i, m] += out[j, i, m]
    return bool(cholesky(H, rest, L))


@inlined
def add_sorted(precision: Array, e: Array, rest: int, J: Array, force: Array, gradient: Array, H: Array) -> float:
    """Add one term to the gradient and to the last rows of the Hessian.

    Parameters
    ----------
    precision
        (n, n), of `sort_terms`
    e
        (n,), the error, in the same order
    rest
        number of dimensions of R^n
    J, force
        (S, 3, 3) and (n,), scratch
    gradient
        (n,), added to
    H
        (n - rest, n), added to: rows of S³, lower triangle

    Returns
    -------
    float
        half the cost of the term
    """
    n, S = len(e), (len(e) - rest) // 3
    force[:] = 0.0
    for m in range(n):
        share = e[m]
        for i in range(n):
            force[i] += share * precision[m, i]
    cost = 0.0
    for i in range(n):
        cost += 0.5 * e[i] * force[i]
    for i in range(rest):
        gradient[i] += force[i]
    for s in range(S):
        r = rest + 3 * s
        inverse_left_jacobian(e[r], e[r + 1], e[r + 2], J[s])
        for i in range(3):
            a, b, c = J[s, 0, i], J[s, 1, i], J[s, 2, i]
            gradient[r + i] += a * force[r] + b * force[r + 1] + c * force[r + 2]
            for k in range(rest):
                H[3 * s + i, k] += a * precision[r, k] + b * precision[r + 1, k] + c * precision[r + 2, k]
            for q in range(s + 1):
                k = rest + 3 * q
                x = a * precision[r, k] + b * precision[r + 1, k] + c * precision[r + 2, k]
                y = a * precision[r, k + 1] + b * precision[r + 1, k + 1] + c * precision[r + 2, k + 1]
                z = a * precision[r, k + 2] + b * precision[r + 1, k + 2] + c * precision[r + 2, k + 2]
                for m in range(3):
                    H[3 * s + i, k + m] += x * J[q, 0, m] + y * J[q, 1, m] + z * J[q, 2, m]
    return cost


@inlined
def solve_sorted(H: Array, gradient: Array, rest: int, L: Array, step: Array) -> bool:
    """Complete the factor, and make the Gauss-Newton step.

    Parameters
    ----------
    H, gradient
        (n - rest, n) and (n,), of `add_sorted`
    rest
        number of dimensions of R^n
    L
        (n, n), the factor; its last rows are written
    step
        (n,), written: -(L L^T)^-1 gradient

    Returns
    -------
    bool
        False where the Hessian is not positive definite
    """
    n = len(gradient)
    for i in range(rest, n):
        for j in range(i + 1):
            total = H[i - rest, j]
            for m in range(j):
                total -= L[i, m] * L[j, m]
            if j < i:
                L[i, j] = total * L[j, j]
            elif total > 0.0:
                L[i, i] = 1.0 / math.sqrt(total)
            else:
                return False
    for i in range(n):
        total = -gradient[i]
        for m in range(i):
            total -= L[i, m] * step[m]
        step[i] = total * L[i, i]
    for i in range(n - 1, -1, -1):
        step[i] *= L[i, i]
        for m in range(i):
            step[m] -= L[i, m] * step[i]
    return True


@inlined
def invert_sorted(L: Array, order: Array, scratch: Array, covariance: Array) -> float:
    """The inverse of a factorised Hessian, in the manifold's own order.

    Parameters
    ----------
    L
        (n, n), of `solve_sorted`; changed
    order
        of `sort_dimensions`
    scratch
        (n, n)
    covariance
        (n, n), written

    Returns
    -------
    float
        its trace
    """
    n = len(order)
    invert_lower(L, n, scratch)
    gram(scratch, n, L)
    trace = 0.0
    for i in range(n):
        trace += L[i, i]
        for m in range(n):
            covariance[order[i], order[m]] = L[i, m]
    return trace
