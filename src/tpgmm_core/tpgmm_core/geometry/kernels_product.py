# SPDX-License-Identifier: Apache-2.0
"""The product of Gaussians on R^n and S³ (Eqs. 3, 6), compiled.

`flat[i]` is the ambient index of tangent dimension i, or -1 on S³, and `spheres[s]` = (first ambient, first tangent
index) of each S³ factor: `Manifold.ambient_of_tangent` and `Manifold.sphere_starts`.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import (
    cholesky,
    compiled,
    gram,
    inverse_left_jacobian,
    invert_lower,
    quaternion_difference,
    turn,
)

STEP_TOLERANCE = 1e-10  # Gauss-Newton on S³ stops at steps shorter than this
# The gain of a step is twice what it lowers the cost by: its squared length, in standard deviations of the product
SMALL_GAIN = 1e-9  # of the cost: below it a step is not too long, whatever the rounding of the cost says
ROUNDED_GAIN = 1e-13  # below it a gain that no longer falls is rounding: large precisions of large numbers
MAX_STEPS = 100
SHORT_TURN = math.cos(math.pi / 8.0)  # scalar product of quaternions that are a turn of pi / 4 apart
SLOWEST_RATE = 0.95  # of convergence that extrapolation makes up for


@compiled
def difference(x: Array, base: Array, flat: Array, spheres: Array, out: Array) -> None:
    """Tangent vector between two points: out (n,) = log_base(x)."""
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
    """Move a point in place: x ← exp_x(step)."""
    for i in range(len(flat)):
        if flat[i] >= 0:
            x[flat[i]] += step[i]
    for s in range(len(spheres)):
        a, t = spheres[s]
        turn(x[a : a + 4], step[t], step[t + 1], step[t + 2])


@compiled
def continued_difference(x: Array, base: Array, flat: Array, spheres: Array, out: Array) -> None:
    """`difference`, but on S³ the turn between the quaternions as their signs are, up to 2 pi.

    It is smooth where the shortest turn changes sides.
    """
    for i in range(len(flat)):
        if flat[i] >= 0:
            out[i] = x[flat[i]] - base[flat[i]]
    for s in range(len(spheres)):
        a, t = spheres[s]
        px, py, pz, pw = x[a], x[a + 1], x[a + 2], x[a + 3]
        qx, qy, qz, qw = base[a], base[a + 1], base[a + 2], base[a + 3]
        vx = -pw * qx + px * qw - py * qz + pz * qy
        vy = -pw * qy + px * qz + py * qw - pz * qx
        vz = -pw * qz - px * qy + py * qx + pz * qw
        sine = math.sqrt(vx * vx + vy * vy + vz * vz)
        factor = 2.0
        if sine > 1e-9:
            factor = 2.0 * math.atan2(sine, pw * qw + px * qx + py * qy + pz * qz) / sine
        out[t], out[t + 1], out[t + 2] = factor * vx, factor * vy, factor * vz


@compiled
def along(x: Array, y: Array, a: int) -> float:
    """Scalar product of the quaternions at ambient index a: positive where both lie on the same half of the sphere."""
    total: float = x[a] * y[a] + x[a + 1] * y[a + 1] + x[a + 2] * y[a + 2] + x[a + 3] * y[a + 3]
    return total


@compiled
def add_term(
    x: Array, target: Array, precision: Array, flat: Array, spheres: Array, scratch: Array, gradient: Array,
    hessian: Array,
) -> float:  # fmt: skip
    """Add one term of Eq. (3), with its target and precision, at x; returns half its cost.

    Added to are gradient (n,) and Gauss-Newton Hessian (n, n). On S³ the error e = Log(x ⊗ target^-1) moves with x by
    the inverse left Jacobian J of SO(3). precision: lower triangle (n, n).
    """
    difference(x, target, flat, spheres, scratch[0])
    cost: float = add_error(precision, spheres, scratch, gradient, hessian)
    return cost


@compiled
def add_error(precision: Array, spheres: Array, scratch: Array, gradient: Array, hessian: Array) -> float:
    """`add_term` for the error (n,) that lies in the first row of scratch."""
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
    """Working memory of `add_term` and `invert_precision`."""
    return np.empty((5 + n, max(n, 3)))


@compiled
def invert_precision(
    H: Array, gradient: Array, x: Array, state: Array, min_precision: float, flat: Array,
    spheres: Array, scratch: Array, covariance: Array,
) -> float:  # fmt: skip
    """Invert the precision H into covariance; returns the cost of the term that is added to H first.

    Directions of H below min_precision are filled up to it by a term that keeps them at the state.
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
    missing = (vectors * np.maximum(lowest - values, 0.0)) @ vectors.T
    cost = add_term(x, state, missing, flat, spheres, scratch, gradient, H)
    roots = vectors / np.sqrt(np.maximum(values, lowest))
    covariance[:] = roots @ roots.T
    return cost


@compiled
def term_cost(x: Array, target: Array, precision: Array, flat: Array, spheres: Array, e: Array) -> float:
    """Half the cost of one term of Eq. (3), the logarithm as signs are. precision: lower triangle; e (n,): scratch."""
    continued_difference(x, target, flat, spheres, e)
    cost = 0.0
    for i in range(len(flat)):
        cost += 0.5 * precision[i, i] * e[i] * e[i]
        for m in range(i):
            cost += precision[i, m] * e[i] * e[m]
    return cost


@compiled
def choose_ways(x: Array, target: Array, precision: Array, flat: Array, spheres: Array, e: Array) -> bool:
    """Change signs of the target's quaternions where the other way round to x costs less; whether one was changed.

    Turns below pi / 4 are not looked at. e (n,): scratch.
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


@compiled
def fuse(
    targets: Array, precisions: Array, weights: Array, state: Array, min_precision: float, flat: Array, spheres: Array,
    mean: Array, covariance: Array,
) -> bool:  # fmt: skip
    """Product of Gaussians (Eqs. 3, 6) by Gauss-Newton steps, of which R^n needs one; False without convergence.

    targets (P, D), precisions (P, n, n) lower triangles; terms of weight 0 are left out. Writes mean (D,) and
    covariance (n, n), the inverse Gauss-Newton Hessian there in fixed axes.

    On S³ it begins at the surest term, each other one the shortest way from there. The turn to a term is then
    continued, beyond pi if need be, since a cost of shortest turns that are correlated with other dimensions jumps
    where these change sides, and may have no minimum. At the end the other way round is taken where that costs less,
    and the search goes on: what is minimised is the cost of the better way of each term, which does not jump. Steps
    that do not lower the cost are halved; where the terms contradict each other so much that steps become shorter at a
    constant rate only, they are extrapolated. Numbers of R^n are counted from the surest term's, so that a world far
    from its origin, or times since 1970, cost no digits. Without convergence in MAX_STEPS, as when correlations ask for
    more than a whole turn, mean and covariance mean nothing.
    """
    n, P = len(flat), len(weights)
    gradient, H = np.empty(n), np.empty((n, n))
    step, former_step, scratch = np.zeros(n), np.zeros(n), scratch_for(n)
    # starting from the surest term keeps the residuals on S³ small
    surest = 0.0
    mean[:] = state
    for j in range(P):
        trace = 0.0
        for i in range(n):
            if flat[i] < 0 or len(spheres) == 0:
                trace += precisions[j, i, i]
        if weights[j] > 0.0 and trace > surest:
            surest = trace
            mean[:] = targets[j]
    signed = np.empty((P + 1, targets.shape[1]))  # the last one is the state
    signed[:P], signed[P] = targets, state
    for s in range(len(spheres)):
        a = spheres[s, 0]
        for j in range(P + 1):
            if along(signed[j], mean, a) < 0.0:
                for i in range(a, a + 4):
                    signed[j, i] = -signed[j, i]
    base = mean.copy()
    for i in range(n):
        if flat[i] >= 0:
            for j in range(P + 1):
                signed[j, flat[i]] -= base[flat[i]]
            mean[flat[i]] = 0.0
    is_found = False
    former_cost, gain, is_plain = np.inf, np.inf, False
    for _ in range(MAX_STEPS):
        gradient[:] = 0.0
        H[:] = 0.0
        cost = 0.0
        for j in range(P):
            if weights[j] > 0.0:
                continued_difference(mean, signed[j], flat, spheres, scratch[0])
                cost += add_error(precisions[j], spheres, scratch, gradient, H)
        cost += invert_precision(H, gradient, mean, signed[P], min_precision, flat, spheres, scratch, covariance)
        if cost > former_cost * (1.0 + 1e-12) and gain > SMALL_GAIN * cost:
            for i in range(n):  # too far: half the way back
                step[i] *= -0.5
            move(mean, step, flat, spheres)
            for i in range(n):
                step[i] *= -1.0
            gain *= 0.25
            is_plain = False
            continue
        former_cost, former_gain = cost, gain
        repeated, squared, former_squared, gain = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            total = 0.0
            for m in range(n):
                total -= covariance[i, m] * gradient[m]
            step[i] = total
            gain -= total * gradient[i]
            repeated += total * former_step[i]
            squared += total * total
            former_squared += former_step[i] * former_step[i]
        is_short = longest(step) < STEP_TOLERANCE or (gain < ROUNDED_GAIN and gain > 0.25 * former_gain)
        former_step[:] = step
        is_along = repeated > 0.5 * former_squared and repeated * repeated > 0.8 * squared * former_squared
        if is_plain and not is_short and is_along:
            rate = min(repeated / former_squared, SLOWEST_RATE)
            for i in range(n):
                step[i] /= 1.0 - rate
            is_plain = False
        else:
            is_plain = True
        move(mean, step, flat, spheres)
        if len(spheres) == 0:
            is_found = True
            break
        if is_short:
            is_changed = False
            for j in range(P):
                if weights[j] > 0.0 and choose_ways(mean, signed[j], precisions[j], flat, spheres, gradient):
                    is_changed = True
            if not is_changed:
                is_found = True
                break
            former_cost, gain, is_plain = np.inf, np.inf, False
    for i in range(n):
        if flat[i] >= 0:
            mean[flat[i]] += base[flat[i]]
    return is_found
