# SPDX-License-Identifier: Apache-2.0
"""The product of Gaussians on R^n and S³ (Eqs. 3, 6), compiled.

`flat` and `spheres` say how a manifold is arranged: see `kernels_manifold`.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, copy, copy_rows
from tpgmm_core.geometry.kernels_by_parts import add_sorted, invert_sorted, solve_sorted, sort_dimensions, sort_terms
from tpgmm_core.geometry.kernels_manifold import along, continued_difference, longest, move
from tpgmm_core.geometry.kernels_terms import add_error, choose_ways, invert_precision, scratch_for

STEP_TOLERANCE = 1e-10  # Gauss-Newton on S³ stops at steps shorter than this
# The gain of a step is twice what it lowers the cost by: its squared length, in standard deviations of the product
SMALL_GAIN = 1e-9  # of the cost: below it a step is not too long, whatever the rounding of the cost says
ROUNDED_GAIN = 1e-13  # below it a gain that no longer falls is rounding: large precisions of large numbers
MAX_STEPS = 100
FOUND, NOT_FOUND, UNSURE = 1, 0, -1
SLOWEST_RATE = 0.95  # of convergence that extrapolation makes up for


@compiled
def fuse(
    targets: Array, precisions: Array, weights: Array, state: Array, min_precision: float, flat: Array, spheres: Array,
    mean: Array, covariance: Array,
) -> bool:  # fmt: skip
    """Product of Gaussians (Eqs. 3, 6) by Gauss-Newton steps, of which R^n needs one.

    On S³ it begins at the surest term, each other one the shortest way from there. The turn to a term is then
    continued, beyond pi if need be, since a cost of shortest turns that are correlated with other dimensions jumps
    where these change sides, and may have no minimum. At the end the other way round is taken where that costs less,
    and the search goes on: what is minimised is the cost of the better way of each term, which does not jump. Steps
    that do not lower the cost are halved; where the terms contradict each other so much that steps become shorter at a
    constant rate only, they are extrapolated. Numbers of R^n are counted from the surest term's, so that a world far
    from its origin, or times since 1970, cost no digits.

    Parameters
    ----------
    targets
        (P, D)
    precisions
        (P, n, n), lower triangles
    weights
        (P,); terms of weight 0 are left out
    state
        (D,), where directions that no term constrains stay
    min_precision
        smallest eigenvalue of the product's precision
    flat, spheres
        see the module
    mean, covariance
        (D,) and (n, n), written: the minimiser, and the inverse Gauss-Newton Hessian there in fixed axes

    Returns
    -------
    bool
        False without convergence in MAX_STEPS, as when correlations ask for more than a whole turn; mean and covariance
        then mean nothing
    """
    found = UNSURE
    for by_parts in (len(spheres) > 0, False):  # a variable: for two constants `search` would be compiled twice
        found = search(targets, precisions, weights, state, min_precision, flat, spheres, by_parts, mean, covariance)
        if found != UNSURE:
            break
    return bool(found == FOUND)


@compiled
def search(
    targets: Array, precisions: Array, weights: Array, state: Array, min_precision: float, flat: Array, spheres: Array,
    by_parts: bool, mean: Array, covariance: Array,
) -> int:  # fmt: skip
    """`fuse`, with one of two ways to make a step.

    Parameters
    ----------
    targets, precisions, weights, state, min_precision, flat, spheres
        of `fuse`
    by_parts
        whether steps are made by parts (`kernels_by_parts`), which is faster, but not possible where a direction may
        have to be kept at the state
    mean, covariance
        of `fuse`

    Returns
    -------
    int
        FOUND, NOT_FOUND, or UNSURE where by_parts is not possible
    """
    n, P = len(flat), len(weights)
    gradient, H = np.empty(n), np.empty((n, n))
    step, former_step, scratch = np.zeros(n), np.zeros(n), scratch_for(n)
    # starting from the surest term keeps the residuals on S³ small
    surest = 0.0
    copy(state, mean)
    for j in range(P):
        trace = 0.0
        for i in range(n):
            if flat[i] < 0 or len(spheres) == 0:
                trace += precisions[j, i, i]
        if weights[j] > 0.0 and trace > surest:
            surest = trace
            copy(targets[j], mean)
    signed = np.empty((P + 1, targets.shape[1]))  # the last one is the state
    copy_rows(targets, signed)
    copy(state, signed[P])
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
    order, rest, e, sorted_step = sort_dimensions(flat, spheres), n - 3 * len(spheres), np.empty(n), np.empty(n)
    terms, L, J, force = np.empty((P, n, n)), np.zeros((n, n)), np.empty((len(spheres), 3, 3)), np.empty(n)
    if by_parts and not sort_terms(precisions, weights, order, rest, terms, L):
        return UNSURE
    is_found = False
    former_cost, gain, is_plain = np.inf, np.inf, False
    for _ in range(MAX_STEPS):
        gradient[:] = 0.0
        H[:] = 0.0
        cost = 0.0
        for j in range(P):
            if weights[j] > 0.0:
                continued_difference(mean, signed[j], flat, spheres, scratch[0])
                if by_parts:
                    for i in range(n):
                        e[i] = scratch[0, order[i]]
                    cost += add_sorted(terms[j], e, rest, J, force, gradient, H)
                else:
                    cost += add_error(precisions[j], spheres, scratch, gradient, H)
        if not by_parts:
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
        if by_parts and not solve_sorted(H, gradient, rest, L, sorted_step):
            return UNSURE
        for i in range(n):
            if by_parts:
                step[order[i]] = sorted_step[i]
                gain -= sorted_step[i] * gradient[i]
                continue
            step[i] = 0.0
            for m in range(n):
                step[i] -= covariance[i, m] * gradient[m]
            gain -= step[i] * gradient[i]
        for i in range(n):
            repeated += step[i] * former_step[i]
            squared += step[i] * step[i]
            former_squared += former_step[i] * former_step[i]
        is_short = longest(step) < STEP_TOLERANCE or (gain < ROUNDED_GAIN and gain > 0.25 * former_gain)
        copy(step, former_step)
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
    if by_parts and is_found and not invert_sorted(L, order, H, covariance) * min_precision < 1.0:
        return UNSURE  # maybe an eigenvalue below min_precision
    return FOUND if is_found else NOT_FOUND
