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
from tpgmm_core.geometry.kernels import compiled, copy_rows, inlined
from tpgmm_core.geometry.kernels_manifold import longest, move
from tpgmm_core.geometry.kernels_product import ROUNDED_GAIN
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.retrieval.banded import cholesky_band, solve_band
from tpgmm_core.retrieval.kernels_smoothing import assemble, differences

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
    # contiguous: `interpolate` is compiled for one layout
    velocities, accelerations = np.ascontiguousarray(rates[:, :n]), np.ascontiguousarray(rates[:, n:])
    return Smooth(points, velocities, accelerations, iterations)


@inlined
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
        cost = assemble(
            first, weights, means, precisions, states, flat, spheres, points, rates, with_hessian, band, step
        )
        if cost > former_cost and is_curved and length > LINEAR_STEP:  # too far: half the way back
            for k in range(len(step)):
                step[k] = 0.5 * former_step[k]
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
            copy_rows(points, former_points)
        copy_rows(former_points, points)
        for t in range(T):
            move(points[t], step[t * n : (t + 1) * n], flat, spheres)
        extent, largest = _extent(points, flat, spheres)
        if is_rounded or length <= max(tolerance * extent, 4.0 * 2.2e-16 * largest):
            iterations = i + 1
            break
    if iterations == NOT_CONVERGED:
        return NOT_CONVERGED
    differences(first, weights, flat, spheres, points, rates)
    return iterations
