# SPDX-License-Identifier: Apache-2.0
"""Interpolation between the points of a trajectory on a manifold, compiled."""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, copy
from tpgmm_core.geometry.kernels_manifold import difference, move
from tpgmm_core.geometry.kernels_rotation import inverse_left_jacobian


@compiled
def interpolate(
    grid: Array, points: Array, velocities: Array, flat: Array, spheres: Array, times: Array, out_points: Array
) -> None:
    """Points (H, D) at times (H,), from those at the times of the grid (T,), which increase.

    They go along cubics with the velocities (T, n) of the grid, in the tangent space at the former point of the grid,
    hence with continuous velocity. Before the grid and after it, its ends last.
    """
    n = len(flat)
    e, step, J = np.empty(n), np.empty(n), np.empty((3, 3))
    for h in range(len(times)):
        t = min(max(times[h], grid[0]), grid[-1])
        i = min(max(np.searchsorted(grid, t, side="right") - 1, 0), len(grid) - 2)
        interval = grid[i + 1] - grid[i]
        s = (t - grid[i]) / interval
        reached = s * s * (3.0 - 2.0 * s)
        leaving, arriving = interval * s * (1.0 - s) ** 2, interval * s * s * (1.0 - s)
        difference(points[i + 1], points[i], flat, spheres, e)
        for m in range(n):
            step[m] = reached * e[m] + leaving * velocities[i, m] - arriving * velocities[i + 1, m]
        for k in range(len(spheres)):
            a = spheres[k, 1]
            # how fast the rotation vector from the former point changes where the next one is reached
            inverse_left_jacobian(e[a], e[a + 1], e[a + 2], J)
            for m in range(3):
                rate = 0.0
                for o in range(3):
                    rate += J[m, o] * velocities[i + 1, a + o]
                step[a + m] = reached * e[a + m] + leaving * velocities[i, a + m] - arriving * rate
        copy(points[i], out_points[h])
        move(out_points[h], step, flat, spheres)
