# SPDX-License-Identifier: Apache-2.0
"""The terms of Eq. (3) on R^n and S³, compiled: costs, gradients and Hessians, and the inverse of their sum.

`flat` and `spheres` say how a manifold is arranged: see `kernels_manifold`.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, gram, inlined, invert_lower
from tpgmm_core.geometry.kernels_manifold import along, continued_difference, difference
from tpgmm_core.geometry.kernels_rotation import inverse_left_jacobian

SHORT_TURN = math.cos(math.pi / 8.0)  # scalar product of quaternions that are a turn of pi / 4 apart


@compiled
def add_term(
    x: Array, target: Array, precision: Array, flat: Array, spheres: Array, scratch: Array, gradient: Array,
    hessian: Array,
) -> float:  # fmt: skip
    """Add one term of Eq. (3) at a point.

    On S³ the error e = Log(x ⊗ target^-1) moves with x by the inverse left Jacobian J of SO(3).

    Parameters
    ----------
    x, target
        (D,), the point and where the term is 0
    precision
        (n, n), lower triangle
    flat, spheres
        see the module
    scratch
        of `scratch_for`
    gradient, hessian
        (n,) and Gauss-Newton (n, n), added to

    Returns
    -------
    float
        half the cost of the term
    """
    difference(x, target, flat, spheres, scratch[0])
    cost: float = add_error(precision, spheres, scratch, gradient, hessian)
    return cost


@compiled
def add_error(precision: Array, spheres: Array, scratch: Array, gradient: Array, hessian: Array) -> float:
    """`add_term` for an error that is known.

    Parameters
    ----------
    precision
        (n, n), lower triangle
    spheres
        see the module
    scratch
        of `scratch_for`; the error (n,) lies in its first row
    gradient, hessian
        (n,) and Gauss-Newton (n, n), added to

    Returns
    -------
    float
        half the cost of the term
    """
    n = len(gradient)
    e, force, J, B = scratch[0], scratch[1], scratch[2:5], scratch[5:]
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
    """Working memory of `add_term` and `invert_precision`.

    Parameters
    ----------
    n
        tangent dimensions

    Returns
    -------
    Array
        (5 + n, max(n, 3)), not initialised
    """
    return np.empty((5 + n, max(n, 3)))


@compiled
def invert_precision(
    H: Array, gradient: Array, x: Array, state: Array, min_precision: float, flat: Array,
    spheres: Array, scratch: Array, covariance: Array,
) -> float:  # fmt: skip
    """Invert a precision, once its directions below min_precision are filled up by a term that keeps them at the state.

    Parameters
    ----------
    H, gradient
        (n, n) and (n,); the term is added to them
    x, state
        (D,)
    min_precision
        smallest eigenvalue that the precision is to have
    flat, spheres
        see the module
    scratch
        of `scratch_for`
    covariance
        (n, n), written

    Returns
    -------
    float
        half the cost of the term that was added; 0 where none was needed
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
    # rounding of a large precision must not count as information about the free directions
    lowest = max(min_precision, 1e-13 * values[-1])
    missing = np.zeros((n, n))
    for i in range(n):
        for m in range(n):
            covariance[i, m] = 0.0
            for k in range(n):
                missing[i, m] += vectors[i, k] * vectors[m, k] * max(lowest - values[k], 0.0)
                covariance[i, m] += vectors[i, k] * vectors[m, k] / max(values[k], lowest)
    cost: float = add_term(x, state, missing, flat, spheres, scratch, gradient, H)
    return cost


@compiled
def term_cost(x: Array, target: Array, precision: Array, flat: Array, spheres: Array, e: Array) -> float:
    """Half the cost of one term of Eq. (3), the logarithm as signs are.

    Parameters
    ----------
    x, target
        (D,)
    precision
        (n, n), lower triangle
    flat, spheres
        see the module
    e
        (n,), scratch

    Returns
    -------
    float
        1/2 e^T precision e
    """
    continued_difference(x, target, flat, spheres, e)
    cost = 0.0
    for i in range(len(flat)):
        cost += 0.5 * precision[i, i] * e[i] * e[i]
        for m in range(i):
            cost += precision[i, m] * e[i] * e[m]
    return cost


@inlined
def choose_ways(x: Array, target: Array, precision: Array, flat: Array, spheres: Array, e: Array) -> bool:
    """Change signs of the target's quaternions where the other way round to x costs less.

    Turns below pi / 4 are not looked at.

    Parameters
    ----------
    x, target
        (D,); the target is changed
    precision
        (n, n), lower triangle
    flat, spheres
        see the module
    e
        (n,), scratch

    Returns
    -------
    bool
        whether a sign was changed
    """
    is_changed = False
    for s in range(len(spheres)):
        a = spheres[s, 0]
        if along(x, target, a) < SHORT_TURN:
            former = term_cost(x, target, precision, flat, spheres, e)
            for i in range(a, a + 4):
                target[i] = -target[i]
            if term_cost(x, target, precision, flat, spheres, e) < former * (1.0 - 1e-12):
                is_changed = True
            else:
                for i in range(a, a + 4):
                    target[i] = -target[i]
    return is_changed
