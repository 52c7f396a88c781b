# SPDX-License-Identifier: Apache-2.0
"""The sum that `smoothing` minimises, compiled: its gradient and its Gauss-Newton Hessian, a band.

At one time the derivatives of the residual by the window's three points consist of numbers, which weigh the points in
position, velocity and acceleration, and on S³ of derivatives J of logarithms. The numbers are the same at all times in
the middle of a movement, so that they are applied to a state's precision once (`_fold`); what remains for each time
are rows and columns of S³ (`_turn`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, copy, copy_rows, inlined
from tpgmm_core.geometry.kernels_manifold import difference
from tpgmm_core.geometry.kernels_rotation import inverse_left_jacobian

ALIKE = 1e-9
"""Weights of the same times but for a rounding below this, relative, make the same Hessian; gradients are exact."""


@compiled
def _steps(points: Array, t: int, first: int, ahead: Array, flat: Array, spheres: Array, steps: Array) -> None:
    """Steps (3, n) from x[t] to the window's points.

    The step to the former time is that from there, `ahead` (n,), backwards; on the way `ahead` becomes the step to the
    next time.
    """
    for p in range(3):
        if first + p == t:
            steps[p] = 0.0
        elif first + p == t - 1:
            for i in range(len(flat)):
                steps[p, i] = -ahead[i]
        else:
            difference(points[first + p], points[t], flat, spheres, steps[p])
    if first + 2 > t:
        copy(steps[t + 1 - first], ahead)


@compiled
def _rate(steps: Array, t: int, weights: Array, rates: Array) -> None:
    """Velocity and acceleration, rates (2 n,), at x[t], of steps (3, n) to the window's points; weights (3, T, 3)."""
    n = steps.shape[1]
    for order in range(2):
        a, b, c = weights[1 + order, t, 0], weights[1 + order, t, 1], weights[1 + order, t, 2]
        for i in range(n):
            rates[order * n + i] = a * steps[0, i] + b * steps[1, i] + c * steps[2, i]


@compiled
def differences(first: Array, weights: Array, flat: Array, spheres: Array, points: Array, rates: Array) -> None:
    """Velocities and accelerations of points.

    Parameters
    ----------
    first, weights
        of `difference_weights`
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    points
        (T, D)
    rates
        (T, 2 n), written
    """
    steps, ahead = np.empty((3, len(flat))), np.empty(len(flat))
    for t in range(len(points)):
        _steps(points, t, first[t], ahead, flat, spheres, steps)
        _rate(steps, t, weights, rates[t])


@compiled
def _numbers(own: int, weights: Array, t: int, flat: Array, numbers: Array) -> None:
    """How position, velocity and acceleration change with the window's points: numbers (3, 3 n), by order and point.

    On R^n these are the derivatives. On S³ those by the other points are still to be multiplied by J, and `own`, the
    place of x[t] in the window, counts for its position alone: `_turn` does the rest. weights (3, T, 3).
    """
    n = len(flat)
    numbers[:] = 0.0
    for i in range(n):
        numbers[0, own * n + i] = 1.0
    for order in range(1, 3):
        for p in range(3):
            if p != own:
                weight = weights[order, t, p]
                for i in range(n):
                    numbers[order, p * n + i] = weight
                    if flat[i] >= 0:
                        numbers[order, own * n + i] -= weight


@inlined
def _fold(precision: Array, numbers: Array, half: Array, folded: Array) -> None:
    """Folded = V^T precision V, (3 n, 3 n), with V the numbers of `_numbers`; half (3 n, 3 n) is scratch."""
    N = len(precision)
    n = N // 3
    for r in range(N):
        row = precision[r]
        for q in range(3):
            for m in range(n):
                c = q * n + m
                half[r, c] = numbers[0, c] * row[m] + numbers[1, c] * row[n + m] + numbers[2, c] * row[2 * n + m]
    for q in range(3):
        for m in range(n):
            r = q * n + m
            a, b, c = numbers[0, r], numbers[1, r], numbers[2, r]
            for k in range(N):
                folded[r, k] = a * half[m, k] + b * half[n + m, k] + c * half[2 * n + m, k]


@compiled
def _turn(own: int, spheres: Array, J: Array, F: Array, out: Array) -> None:
    """Rows of S³ of out (3 n, N) = U^T F, where U takes a step to what the numbers of `_numbers` weigh.

    On R^n it changes nothing: these rows are neither read nor written. J (3, S, 3, 3) as in `assemble`.
    """
    n, N = len(F) // 3, F.shape[1]
    for s in range(len(spheres)):
        o = own * n + spheres[s, 1]
        for k in range(N):
            x, y, z = F[o, k], F[o + 1, k], F[o + 2, k]
            for i in range(3):
                out[o + i, k] = J[own, s, 0, i] * x + J[own, s, 1, i] * y + J[own, s, 2, i] * z
        for p in range(3):
            if p == own:
                continue
            r = p * n + spheres[s, 1]
            a, b, c = J[p, s, 0, 0], J[p, s, 0, 1], J[p, s, 0, 2]
            d, e, f = J[p, s, 1, 0], J[p, s, 1, 1], J[p, s, 1, 2]
            g, h, m = J[p, s, 2, 0], J[p, s, 2, 1], J[p, s, 2, 2]
            for k in range(N):
                x, y, z = F[r, k], F[r + 1, k], F[r + 2, k]
                out[o, k] -= a * x + b * y + c * z
                out[o + 1, k] -= d * x + e * y + f * z
                out[o + 2, k] -= g * x + h * y + m * z
                out[r, k] = a * x + d * y + g * z
                out[r + 1, k] = b * x + e * y + h * z
                out[r + 2, k] = c * x + f * y + m * z


@inlined
def _turn_both(
    own: int, spheres: Array, J: Array, folded: Array, rows: Array, half: Array, across: Array, turned: Array,
    hessian: Array,
) -> None:  # fmt: skip
    """Rows and columns of S³ of hessian = U^T folded U, all (3 n, 3 n); on R^n the Hessian is `folded`.

    rows (R,), those of S³. half (3 n, 3 n), across and turned (3 n, R) are scratch.
    """
    N, R = len(folded), len(rows)
    _turn(own, spheres, J, folded, half)
    for c in range(R):
        r = rows[c]
        for k in range(N):
            hessian[r, k] = half[r, k]
            hessian[k, r] = half[r, k]
        for k in range(R):
            across[rows[k], c] = half[r, rows[k]]
    _turn(own, spheres, J, across, turned)
    for c in range(R):
        for k in range(R):
            hessian[rows[c], rows[k]] = turned[rows[c], k]


@inlined
def _rows_on_spheres(n: int, spheres: Array) -> NDArray[np.int64]:
    """Which of the rows of three points are on S³."""
    rows, count = np.empty(9 * len(spheres), dtype=np.int64), 0
    for p in range(3):
        for s in range(len(spheres)):
            for i in range(3):
                rows[count] = p * n + spheres[s, 1] + i
                count += 1
    return rows


@inlined
def _are_alike(weights: Array, t: int, other: int) -> bool:
    """Whether two times' points have the same weights, but for rounding; weights (3, T, 3)."""
    for order in range(1, 3):
        for p in range(3):
            weight = weights[order, t, p]
            if abs(weights[order, other, p] - weight) > ALIKE * abs(weight):
                return False
    return True


@inlined
def assemble(
    first: Array, weights: Array, means: Array, precisions: Array, states: Array, flat: Array, spheres: Array,
    points: Array, rates: Array, with_hessian: bool, band: Array, downhill: Array,
) -> float:  # fmt: skip
    """The sum that is minimised, at some points.

    On S³ the derivatives of a logarithm are exact: J[p] is the inverse left Jacobian of SO(3) for the neighbour p that
    it goes to, its transpose, negative, belongs to the point from which it goes, and J[own] is that of the position.

    Parameters
    ----------
    first, weights, means, precisions, states
        as for `smoothest`
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    points
        (T, D)
    rates
        (T, 2 n), written: velocities and accelerations
    with_hessian
        whether the Hessian is asked for
    band
        (T n, 3 n), written if asked for: the Gauss-Newton Hessian, as `cholesky_band` takes it
    downhill
        (T n,), written: the negative gradient

    Returns
    -------
    float
        half the sum
    """
    T, n, D, S = len(points), len(flat), points.shape[1], len(spheres)
    steps, ahead, residual, force = np.empty((3, n)), np.empty(n), np.empty(3 * n), np.empty(3 * n)
    numbers, J = np.empty((3, 3 * n)), np.empty((3, S, 3, 3))
    rows, pull, turned_pull = _rows_on_spheres(n, spheres), np.empty((3 * n, 1)), np.empty((3 * n, 1))
    half, folded, hessian = np.empty((3 * n, 3 * n)), np.empty((3 * n, 3 * n)), np.empty((3 * n, 3 * n))
    across, turned = np.empty((3 * n, len(rows))), np.empty((3 * n, len(rows)))
    downhill[:] = 0.0
    if with_hessian:
        band[:] = 0.0
    cost, last = 0.0, -1
    for t in range(T):
        precision, mean, base, own = precisions[states[t]], means[states[t]], first[t] * n, t - first[t]
        _numbers(own, weights, t, flat, numbers)
        _steps(points, t, first[t], ahead, flat, spheres, steps)
        _rate(steps, t, weights, rates[t])
        difference(points[t], mean[:D], flat, spheres, residual[:n])
        for i in range(2 * n):
            residual[n + i] = rates[t, i] - mean[D + i]
        force[:] = 0.0
        for m in range(3 * n):
            row, share = precision[m], residual[m]
            for i in range(3 * n):
                force[i] += share * row[i]
        for i in range(3 * n):
            cost += 0.5 * residual[i] * force[i]
        for s in range(S):
            a = spheres[s, 1]
            for p in range(3):
                e = residual if p == own else steps[p]
                inverse_left_jacobian(e[a], e[a + 1], e[a + 2], J[p, s])
        for p in range(3):
            for i in range(n):
                c = p * n + i
                pull[c, 0] = numbers[0, c] * force[i] + numbers[1, c] * force[n + i] + numbers[2, c] * force[2 * n + i]
                if flat[i] >= 0:
                    downhill[base + c] -= pull[c, 0]
        _turn(own, spheres, J, pull, turned_pull)
        for r in rows:
            downhill[base + r] -= turned_pull[r, 0]
        if with_hessian:
            is_folded = last >= 0 and states[last] == states[t] and t - first[t] == last - first[last]
            if not (is_folded and _are_alike(weights, t, last)):
                last = t
                _fold(precision, numbers, half, folded)
                copy_rows(folded, hessian)
            if S > 0:
                _turn_both(own, spheres, J, folded, rows, half, across, turned, hessian)
            _add_rows(hessian, base, band)
    return cost


@inlined
def _add_rows(hessian: Array, base: int, band: Array) -> None:
    """Add a symmetric matrix (3 n, 3 n) to the band (T n, 3 n), from row `base` on."""
    N = len(hessian)
    for i in range(N):
        r, shift = base + i, N - 1 - i
        for m in range(i + 1):
            band[r, shift + m] += hessian[i, m]
