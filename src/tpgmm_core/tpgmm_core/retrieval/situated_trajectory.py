# SPDX-License-Identifier: Apache-2.0
"""What a trajectory model becomes in one situation: points, and how far demonstrations are apart there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.model.kernels_regress import spread_at
from tpgmm_core.retrieval import kernels_trajectory as kernels
from tpgmm_core.retrieval.dynamic_features import point_manifold
from tpgmm_core.retrieval.interpolation import interpolate
from tpgmm_core.retrieval.smoothing import STEP_TOLERANCE, Smooth, smoothest


def smoothest_of(
    mixture: GaussianMixture,
    times: Array,
    windows: tuple[NDArray[np.intp], Array],
    states: NDArray[np.intp],
    former: Array | None = None,
    tolerance: float = STEP_TOLERANCE,
) -> Smooth:
    """The points that fit a mixture best.

    Parameters
    ----------
    mixture
        over [time, position, velocity, acceleration]
    times
        (T,), s
    windows
        of `difference_weights` for the times
    states
        (T,), the component at each time
    former
        (T, D), where to begin; None: on straight ways between the states' positions
    tolerance
        as for `smoothest`

    Returns
    -------
    Smooth
        points and their derivatives

    Raises
    ------
    ValueError
        like `smoothest`
    """
    K, n = mixture.means.shape[0], mixture.covariances.shape[1] - 1
    precisions = np.empty((K, n, n))
    kernels.precisions_without_time(np.array(mixture.covariances, order="C"), precisions)
    means = np.ascontiguousarray(mixture.means[:, 1:])
    manifold = point_manifold(mixture.manifold)
    start = _between(times, states, means[:, : manifold.dim], manifold) if former is None else former
    return smoothest(*windows, means, precisions, states, manifold, start, tolerance)


def _between(times: Array, states: NDArray[np.intp], positions: Array, manifold: Manifold) -> Array:
    """Points (T, D) that go from one state's position (K, D) to the next one's, each in the middle of its time."""
    begins = np.flatnonzero(np.diff(states, prepend=-1))
    ends = np.append(begins[1:], len(times)) - 1
    middles, corners = 0.5 * (times[begins] + times[ends]), positions[states[begins]]
    i = np.clip(np.searchsorted(middles, times, side="right") - 1, 0, max(len(begins) - 2, 0))
    following = np.minimum(i + 1, len(begins) - 1)
    interval = np.maximum(middles[following] - middles[i], np.finfo(float).tiny)
    share = np.clip((times - middles[i]) / interval, 0.0, 1.0)[:, None]
    return manifold.exp(corners[i], share * manifold.log(corners[i], corners[following]))


class Spread:
    """How far demonstrations are apart in a situation: see `trajectory`.

    Parameters
    ----------
    mixture
        over [time, position, velocity, acceleration]
    """

    def __init__(self, mixture: GaussianMixture) -> None:
        points = point_manifold(mixture.manifold)
        D, n = points.dim, points.tangent_dim
        seen = mixture.manifold.subset(range(1 + D))
        self._means = np.ascontiguousarray(mixture.means[:, : 1 + D])
        self._covariances = np.ascontiguousarray(mixture.covariances[:, : 1 + n, : 1 + n])
        self._layout = seen.ambient_of_tangent, seen.sphere_starts, points.ambient_of_tangent, points.sphere_starts

    def at(self, times: Array, activations: Array, positions: Array) -> Array:
        """Covariances at smooth positions.

        Parameters
        ----------
        times, activations, positions
            (H,), (H, K) and (H, D)

        Returns
        -------
        Array
            shape (H, n, n)
        """
        n = self._covariances.shape[1] - 1
        covariances = np.empty((len(times), n, n))
        spread_at(activations, self._means, self._covariances, times, positions, *self._layout, covariances)
        return covariances


def interpolated(grid: Array, smooth: Smooth, manifold: Manifold, times: Array) -> Array:
    """Points (H, D) at times (H,), s, of a solution at the times of the grid (T,)."""
    means = np.empty((len(times), manifold.dim))
    layout = manifold.ambient_of_tangent, manifold.sphere_starts
    interpolate(grid, smooth.points, smooth.velocities, *layout, times, means)
    return means
