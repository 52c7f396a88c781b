# SPDX-License-Identifier: Apache-2.0
"""A Gaussian per time step and frame, fused by the product of Eq. (6) at the time that is asked for.

Between steps, each frame's mean goes along a cubic with continuous velocity, and its covariance is mixed. Only what is
asked for is computed: a step costs as much as regression before the product with two components.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.kernels import compiled, copy_rows
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.step_mixture import StepMixture
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.model.kernels_regress import lay_out_precision
from tpgmm_core.retrieval.interpolation import interpolate
from tpgmm_core.retrieval.local_steps import LocalSteps
from tpgmm_core.retrieval.regression import RegressThenProduct


class TimeSteps(RegressThenProduct):
    """The movement of a `StepMixture` as a `TimeParametrized`.

    Parameters
    ----------
    model
        fitted

    Raises
    ------
    ValueError
        for a model without time
    """

    def __init__(self, model: LearnedMixture) -> None:
        assert isinstance(model, StepMixture)  # checked by `RetrievalMethod.check`
        names = model.frame_names_
        T, P = len(model.priors_), len(names)
        sizes = np.array([[m.dim - 1, m.tangent_dim - 1] for m in model.frame_manifolds_.values()])
        D, n = (int(size) for size in sizes.max(axis=0))
        self._grid = np.ascontiguousarray(model.means_[names[0]][:, 0])
        self._points, self._velocities = np.zeros((P, T, D)), np.zeros((P, T, n))
        self._within = np.zeros((P, T, n, n))
        for j, name in enumerate(names):
            D, n = sizes[j]
            self._points[j, :, :D], self._velocities[j, :, :n], self._within[j, :, :n, :n] = model.steps(name)
        view, spheres = self._view(model.manifold_.subset(range(1, model.manifold_.dim)))
        self._local = None
        if isinstance(model, TimeStepTPGMM) and model.shown_ is not None:
            self._local = LocalSteps(model, self._points, self._velocities, self._within, view, spheres)
        super().__init__(model)

    def _view(self, manifold: Manifold) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """The layout of what frames see, without time."""
        flat = np.arange(self._within.shape[-1]) if manifold.is_euclidean else manifold.ambient_of_tangent
        return flat, manifold.sphere_starts

    @property
    def mode(self) -> int:
        """The way that the movement goes, from 1; it was chosen by the situation, when the movement began, or set."""
        return 1 if self._local is None else self._local.mode + 1

    def choose(self, mode: int) -> None:
        """Go a way of the demonstrations from now on, instead of that of near situations.

        Parameters
        ----------
        mode
            from 1, the way of most demonstrations; 0: by the situation again

        Raises
        ------
        ValueError
            for a way that no demonstration went
        """
        known = 1 if self._local is None else self._local.n_modes
        if not 0 <= mode <= known:
            raise ValueError(f"mode is {mode!r}; expected 1 to {known} (the ways of the demonstrations), or 0 for any")
        if self._local is not None:
            self._local.choose(None if mode == 0 else mode - 1)

    def situate(
        self, frames: Mapping[str, Frame], state: ArrayLike | None = None, weights: Mapping[str, float] | None = None
    ) -> None:
        """Keep the frames, weights and state of this situation for `at`, and how near demonstrations are to it."""
        super().situate(frames, state, weights)
        if self._local is not None:
            self._local.situate(frames)

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """The product over the frames at times (H,), s.

        Raises
        ------
        ValueError
            as of `RegressThenProduct.at`
        """
        times = np.clip(np.asarray(times, dtype=float), self._grid[0], self._grid[-1])
        if self._local is not None:
            self._local.at(times)
        seen, precisions = self._views_for(len(times))
        failed = views_at(
            self._grid, self._points, self._velocities, self._within, self._data_sizes, *self._view(self.manifold),
            self._buffer.weights, times, seen, precisions,
        )  # fmt: skip
        self._refuse_singular(failed)
        means, covariances = self._product(times, seen, precisions)
        near = np.maximum(1.0 - np.abs(self._grid - times[0]) / (self._grid[1] - self._grid[0]), 0.0)
        return means, covariances, near / near.sum()


@compiled
def views_at(
    grid: Array, points: Array, velocities: Array, within: Array, sizes: Array, flat: Array, spheres: Array,
    weights: Array, times: Array, out_means: Array, out_precisions: Array,
) -> int:  # fmt: skip
    """Each frame's Gaussian at some times, laid out for `kernels_adapt.adapt` as if the times were components.

    Parameters
    ----------
    grid
        (T,), times of the steps, s
    points, velocities, within
        (P, T, D_max), (P, T, n_max), (P, T, n_max, n_max): means, their velocities, covariances as each frame sees them
    sizes
        (P, 2), ambient and tangent dimensions of each frame, without time
    flat, spheres
        (n_max,) and (S, 2), the layout of what a frame sees, without time: see `kernels_manifold`
    weights
        (P,), how far each frame is trusted
    times
        (H,), s, within the grid
    out_means, out_precisions
        (P, D_max, H) and (P, n_max, n_max H), written for the frames with a weight

    Returns
    -------
    int
        -1, or the frame whose covariance is singular
    """
    P, H = len(points), len(times)
    for j in range(P):
        if not weights[j] > 0.0:
            continue
        D, n = sizes[j]
        means, S, L = np.empty((H, D)), np.empty((n, n)), np.empty((n, n))
        own_points, own_velocities = np.empty((len(grid), D)), np.empty((len(grid), n))
        copy_rows(points[j, :, :D], own_points)
        copy_rows(velocities[j, :, :n], own_velocities)
        interpolate(grid, own_points, own_velocities, flat[:n], spheres, times, means)
        for h in range(H):
            i = min(max(np.searchsorted(grid, times[h], side="right") - 1, 0), len(grid) - 2)
            s = (times[h] - grid[i]) / (grid[i + 1] - grid[i])
            for o in range(n):
                for m in range(n):
                    S[o, m] = (1.0 - s) * within[j, i, o, m] + s * within[j, i + 1, o, m]
            for o in range(D):
                out_means[j, o, h] = means[h, o]
            if not lay_out_precision(S, L, h, H, out_precisions[j]):
                return j
    return -1
