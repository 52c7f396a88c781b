# SPDX-License-Identifier: Apache-2.0
"""The points on a manifold whose positions, velocities and accelerations together fit best, compiled.

With x[t] a point at each time, v[t] and a[t] the derivatives of the parabola through three neighbours in the tangent
space at x[t], and a Gaussian over all three at each time, what is minimised is the sum over t of

    |log_m(x[t]), v[t] - m_v, a[t] - m_a|²   in the precision of the time's Gaussian.

On R^n these are the normal equations of Zen et al. (2007), solved in one step. On S³ Gauss-Newton steps are taken in
the tangent spaces at all points at once, with the exact derivatives of the logarithm. Either way each time is coupled
with two neighbours on each side only: one step is one banded Cholesky factor, linear in the length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.kernels_manifold import difference, longest, move
from tpgmm_core.geometry.kernels_product import ROUNDED_GAIN
from tpgmm_core.geometry.kernels_rotation import inverse_left_jacobian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.retrieval.banded import cholesky_band, solve_band

MAX_ITERATIONS = 300
STEP_TOLERANCE = 1e-11  # relative to the extent of the points, and in rad: steps shorter than this end the iteration
LINEAR_STEP = 1e-3  # no step that is shorter than this is too long
FACTOR_LEADS = 1e-2  # after a step shorter than this the factor still leads to the solution, by a hundredth each time
NOT_DEFINITE, NOT_CONVERGED = -1, -2


@dataclass(frozen=True, slots=True, eq=False)
class Smooth:
    """What `smoothest` found.

    Parameters
    ----------
    points
        (T, D)
    velocities, accelerations
        (T, n), per s and s²
    iterations
        steps that were taken
    """

    points: Array
    velocities: Array
    accelerations: Array
    iterations: int


def smoothest(
    first: NDArray[np.intp], weights: Array, means: Array, precisions: Array, states: NDArray[np.intp],
    manifold: Manifold, start: Array, tolerance: float = STEP_TOLERANCE,
) -> Smooth:  # fmt: skip
    """Points (T, D) that fit best the positions, velocities and accelerations that the state at each time expects.

    On R^n the second or third step is the last: squaring differences costs half of the digits, so that the residual of
    the first solution is computed without squaring, and solved for again. On S³ steps that do not lower the sum are
    halved, down to LINEAR_STEP; near the solution the factor is kept. Demonstrated states need 4 to 5 steps, states
    that contradict each other by up to half a turn a few dozens.

    Parameters
    ----------
    first, weights
        of `difference_weights` for the times, windows of three samples
    means
        (K, D + 2 n), what each state expects
    precisions
        (K, 3 n, 3 n), in the tangent space at its position
    states
        (T,), the state at each time
    manifold
        of the points
    start
        (T, D), where to begin; matters on S³ only
    tolerance
        steps shorter than this, relative to the extent of the points and in rad, end the iteration

    Returns
    -------
    Smooth
        points and their derivatives

    Raises
    ------
    ValueError
        when the Hessian is not definite, and when MAX_ITERATIONS steps are not enough
    """
    points = np.array(start, dtype=float, order="C")
    T, n = len(points), manifold.tangent_dim
    rates = np.empty((T, 2 * n))
    iterations = _solve(
        first, weights, means, precisions, states, manifold.ambient_of_tangent, manifold.sphere_starts,
        tolerance, points, rates,
    )  # fmt: skip
    if iterations == NOT_DEFINITE or iterations == NOT_CONVERGED and manifold.is_euclidean:
        raise ValueError(
            "the precisions of positions and accelerations are too different for times so close together: take longer "
            "time steps, or a larger reg_covar"
        )
    if iterations == NOT_CONVERGED:
        raise ValueError(
            f"no smooth trajectory was found in {MAX_ITERATIONS} steps: either the orientations of neighbouring states "
            "contradict each other (check the frames), or times are too close together (take longer time steps)"
        )
    return Smooth(points, rates[:, :n], rates[:, n:], iterations)


@compiled
def _rate(
    points: Array, t: int, first: int, weights: Array, flat: Array, spheres: Array, steps: Array, rates: Array
) -> None:
    """Steps (3, n) to the window's points, and rates (2 n,) at x[t]; weights (3, T, 3)."""
    n = len(flat)
    for p in range(3):
        if first + p == t:
            steps[p] = 0.0
        else:
            difference(points[first + p], points[t], flat, spheres, steps[p])
    for order in range(2):
        a, b, c = weights[1 + order, t, 0], weights[1 + order, t, 1], weights[1 + order, t, 2]
        for i in range(n):
            rates[order * n + i] = a * steps[0, i] + b * steps[1, i] + c * steps[2, i]


@compiled
def _differences(first: Array, weights: Array, flat: Array, spheres: Array, points: Array, rates: Array) -> None:
    """Velocities and accelerations, rates (T, 2 n), of points (T, D)."""
    steps = np.empty((3, len(flat)))
    for t in range(len(points)):
        _rate(points, t, first[t], weights, flat, spheres, steps, rates[t])


@compiled
def _derivatives(own: int, weights: Array, t: int, plain: Array) -> None:
    """Derivatives of position, velocity and acceleration by the window's points, on R^n: plain (3, 3).

    The same numbers hold for all dimensions. weights (3, T, 3); `own` is the place of x[t] in the window.
    """
    plain[:] = 0.0
    plain[0, own] = 1.0
    for order in range(1, 3):
        for p in range(3):
            if p != own:
                plain[order, p] += weights[order, t, p]
                plain[order, own] -= weights[order, t, p]


@compiled
def _descend(own: int, plain: Array, flat: Array, spheres: Array, J: Array, force: Array, downhill: Array) -> None:
    """Subtract one time's gradient from downhill (3 n,), at the window's points; force (3 n,): the precise residual."""
    n = len(flat)
    for p in range(3):
        for i in range(n):
            if flat[i] >= 0:
                pull = plain[0, p] * force[i] + plain[1, p] * force[n + i] + plain[2, p] * force[2 * n + i]
                downhill[p * n + i] -= pull
    for s in range(len(spheres)):
        a = spheres[s, 1]
        for i in range(3):
            for m in range(3):
                downhill[own * n + a + m] -= J[own, s, i, m] * force[a + i]
        for p in range(3):
            if p == own:
                continue
            for i in range(3):
                pull = plain[1, p] * force[n + a + i] + plain[2, p] * force[2 * n + a + i]
                for m in range(3):
                    downhill[p * n + a + m] -= J[p, s, i, m] * pull
                    downhill[own * n + a + m] += J[p, s, m, i] * pull


@compiled
def _add_columns(M: Array, J: Array, transposed: bool, sign: float, spheres: Array, out: Array) -> None:
    """Out += sign M D, D the identity with J (S, 3, 3), or the transpose, for each S³; M and out (n, n)."""
    n = len(M)
    for i in range(n):
        for m in range(n):
            out[i, m] += sign * M[i, m]
        for s in range(len(spheres)):
            a = spheres[s, 1]
            for m in range(3):
                total = -M[i, a + m]
                for o in range(3):
                    total += M[i, a + o] * (J[s, m, o] if transposed else J[s, o, m])
                out[i, a + m] += sign * total


@compiled
def _add_rows(M: Array, J: Array, transposed: bool, sign: float, spheres: Array, out: Array) -> None:
    """Out += sign D M, see `_add_columns`."""
    n = len(M)
    for i in range(n):
        for m in range(n):
            out[i, m] += sign * M[i, m]
    for s in range(len(spheres)):
        a = spheres[s, 1]
        for i in range(3):
            for m in range(n):
                total = -M[a + i, m]
                for o in range(3):
                    total += M[a + o, m] * (J[s, o, i] if transposed else J[s, i, o])
                out[a + i, m] += sign * total


@compiled
def _add_hessian(
    own: int, plain: Array, spheres: Array, J: Array, precision: Array, base: int, mixed: Array, forces: Array,
    block: Array, band: Array,
) -> None:  # fmt: skip
    """Add one time's part of the Gauss-Newton Hessian to the band (T n, 3 n), from row `base` on.

    The derivatives of order 1 and 2 by a neighbour are a number times D, the same for both: the number is applied
    first, to blocks of the precision. mixed (3, n, n), forces (3, 3, n, n) and block (n, n) are scratch.
    """
    n = len(block)
    forces[:] = 0.0  # by order and point: what a step of the point changes of the precise residual
    for order in range(3):
        row = precision[order * n : (order + 1) * n]
        for p in range(3):
            if p == own:
                _add_columns(row[:, :n], J[own], False, 1.0, spheres, forces[order, own])
                continue
            b, c = plain[1, p], plain[2, p]
            for i in range(n):
                for m in range(n):
                    mixed[p, i, m] = b * row[i, n + m] + c * row[i, 2 * n + m]
            _add_columns(mixed[p], J[p], False, 1.0, spheres, forces[order, p])
            _add_columns(mixed[p], J[p], True, -1.0, spheres, forces[order, own])
    for q in range(3):
        for p in range(3):
            if p != own:
                b, c = plain[1, p], plain[2, p]
                for i in range(n):
                    for m in range(n):
                        mixed[p, i, m] = b * forces[1, q, i, m] + c * forces[2, q, i, m]
        for p in range(q, 3):
            block[:] = 0.0
            if p == own:
                _add_rows(forces[0, q], J[own], True, 1.0, spheres, block)
                for other in range(3):
                    if other != own:
                        _add_rows(mixed[other], J[other], False, -1.0, spheres, block)
            else:
                _add_rows(mixed[p], J[p], True, 1.0, spheres, block)
            for i in range(n):
                row_of_band, shift = band[base + p * n + i], (3 - p + q) * n - 1 - i
                for m in range(n if q < p else i + 1):
                    row_of_band[shift + m] += block[i, m]


@compiled
def _assemble(
    first: Array, weights: Array, means: Array, precisions: Array, states: Array, flat: Array, spheres: Array,
    points: Array, rates: Array, with_hessian: bool, band: Array, downhill: Array,
) -> float:  # fmt: skip
    """Half the sum that is minimised.

    Writes rates (T, 2 n), the negative gradient downhill (T n,) and, if asked for, the Gauss-Newton Hessian band
    (T n, 3 n). On S³ the derivatives of a logarithm are exact: J[p] is the inverse left Jacobian of SO(3) for the
    neighbour p that it goes to, its transpose, negative, belongs to the point from which it goes, and J[own] is that of
    the position.
    """
    T, n, D = len(points), len(flat), points.shape[1]
    steps, residual, force = np.empty((3, n)), np.empty(3 * n), np.empty(3 * n)
    plain, J = np.empty((3, 3)), np.empty((3, len(spheres), 3, 3))
    mixed, forces, block = np.empty((3, n, n)), np.empty((3, 3, n, n)), np.empty((n, n))
    downhill[:] = 0.0
    if with_hessian:
        band[:] = 0.0
    cost = 0.0
    for t in range(T):
        precision, mean, base, own = precisions[states[t]], means[states[t]], first[t] * n, t - first[t]
        _rate(points, t, first[t], weights, flat, spheres, steps, rates[t])
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
        for s in range(len(spheres)):
            a = spheres[s, 1]
            for p in range(3):
                e = residual if p == own else steps[p]
                inverse_left_jacobian(e[a], e[a + 1], e[a + 2], J[p, s])
        _derivatives(own, weights, t, plain)
        _descend(own, plain, flat, spheres, J, force, downhill[base : base + 3 * n])
        if with_hessian:
            _add_hessian(own, plain, spheres, J, precision, base, mixed, forces, block, band)
    return cost


@compiled
def _extent(points: Array, flat: Array, spheres: Array) -> tuple[float, float]:
    """The longest side of the box around the points, and the largest coordinate; S³ counts as 1 rad."""
    extent = largest = 1.0 if len(spheres) > 0 else 0.0
    for i in range(len(flat)):
        if flat[i] >= 0:
            low, high = np.inf, -np.inf
            for t in range(len(points)):
                low, high = min(low, points[t, flat[i]]), max(high, points[t, flat[i]])
            extent, largest = max(extent, high - low), max(largest, max(abs(low), abs(high)))
    return extent, largest


@compiled
def _solve(
    first: Array, weights: Array, means: Array, precisions: Array, states: Array, flat: Array, spheres: Array,
    tolerance: float, points: Array, rates: Array,
) -> int:  # fmt: skip
    """`smoothest` in place: points (T, D), rates (T, 2 n). Returns the number of steps taken."""
    T, n = len(points), len(flat)
    band, step, former_points = np.empty((T * n, 3 * n)), np.zeros(T * n), points.copy()
    former_cost, length, iterations, is_factor = np.inf, np.inf, NOT_CONVERGED, False
    gain, is_rounded = np.inf, False
    is_curved = len(spheres) > 0
    for i in range(MAX_ITERATIONS):
        with_hessian = not is_factor or (is_curved and length > FACTOR_LEADS)
        former_step = step.copy()
        cost = _assemble(
            first, weights, means, precisions, states, flat, spheres, points, rates, with_hessian, band, step
        )
        if cost > former_cost and is_curved and length > LINEAR_STEP:  # too far: half the way back
            step[:] = 0.5 * former_step
            length *= 0.5
            is_factor = False
        else:
            former_cost = cost
            if with_hessian:
                is_factor = cholesky_band(band)
                if not is_factor:
                    return NOT_DEFINITE
            downhill, former_gain = step.copy(), gain
            solve_band(band, step)
            length, gain = longest(step), np.dot(step, downhill)
            is_rounded = bool(is_curved and 0.25 * former_gain < gain < ROUNDED_GAIN * len(step))
            former_points[:] = points
        points[:] = former_points
        for t in range(T):
            move(points[t], step[t * n : (t + 1) * n], flat, spheres)
        extent, largest = _extent(points, flat, spheres)
        if is_rounded or length <= max(tolerance * extent, 4.0 * 2.2e-16 * largest):
            iterations = i + 1
            break
    if iterations == NOT_CONVERGED:
        return NOT_CONVERGED
    _differences(first, weights, flat, spheres, points, rates)
    return iterations
