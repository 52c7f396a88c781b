# SPDX-License-Identifier: Apache-2.0
"""`SmoothTrajectory`: a smooth trajectory in a loop, in which frames move."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.retrieval import kernels_trajectory as kernels
from tpgmm_core.retrieval.differences import difference_weights
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.situated_trajectory import Spread, interpolated, smoothest_of
from tpgmm_core.retrieval.smoothing import Smooth
from tpgmm_core.retrieval.trajectory import TrajectoryModel

WARM_TURN = 0.2
"""A course begins at its former solution where no state turned by more than this, rad: from there it finds the same."""
WARM_TOLERANCE = 1e-5
"""Steps from a former solution end below this, rad: what is left out is less than a thousandth of it."""


class SmoothTrajectory:
    """A trajectory model as a `TimeParametrized`: solved once for each situation, and interpolated between its steps.

    Where frames have moved little, the search begins at the former solution, which saves most of the Gauss-Newton
    steps. The result depends on the situation alone, up to 1e-7 m or rad.

    Parameters
    ----------
    model
        as for `TrajectoryModel`, with duration_s in its metadata
    steps
        number of steps of a solution, the first one at time 0 of the model, the last one at its duration

    Raises
    ------
    ValueError
        like `TrajectoryModel`, for a duration that is not known, and less than three steps
    """

    def __init__(self, model: LearnedMixture, *, steps: int = 100) -> None:
        self._model = TrajectoryModel(model)
        self._grid = np.linspace(0.0, demonstrated_duration(model), steps)
        self._windows = difference_weights(self._grid)
        self._states = self._model.states(self._grid)
        self.frame_names: tuple[str, ...] = model.frame_names_
        self._points = self._model.manifold
        self._solved: tuple[GaussianMixture, Smooth, Spread] | None = None

    @property
    def manifold(self) -> Manifold:
        """Manifold of the positions."""
        return self._model.manifold

    @property
    def duration(self) -> float:
        """Duration of the demonstrations, s."""
        return float(self._grid[-1])

    def situate(
        self,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        """Solve for this situation. Parameters and errors are those of `TrajectoryModel.retrieve`."""
        mixture = self._model.adapt(frames, state, weights)
        solve = self._grid, self._windows, self._states
        if self._solved is not None and self._are_near(self._solved[0], mixture):
            found = smoothest_of(mixture, *solve, self._solved[1].points, WARM_TOLERANCE)
        else:
            found = smoothest_of(mixture, *solve)
        self._solved = mixture, found, Spread(mixture)

    def _are_near(self, one: GaussianMixture, other: GaussianMixture) -> bool:
        """Whether no state turned by more than WARM_TURN. How far positions moved does not matter: they are linear."""
        cosine = kernels.least_cosine(one.means, other.means, 1, self._points.sphere_starts)
        return bool(cosine > math.cos(0.5 * WARM_TURN))

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """The movement at some of the model's times.

        Parameters
        ----------
        times
            (H,), s

        Returns
        -------
        tuple[Array, Array, Array]
            means (H, D), covariances (H, n, n), and the activations (K,) at the first of the times

        Raises
        ------
        ValueError
            before `situate`
        """
        _, smooth, spread = self._solution()
        times = np.array(times, dtype=float)
        means = interpolated(self._grid, smooth, self._points, times)
        within = np.minimum(np.maximum(times, self._grid[0]), self._grid[-1])
        activations = self._model.activations(within)
        first = activations[0] if within[0] == times[0] else self._model.activations(times[:1])[0]
        return means, spread.at(within, activations, means), first

    def mixture(self) -> GaussianMixture:
        """The model in this situation.

        Returns
        -------
        GaussianMixture
            over [time, position, velocity, acceleration]

        Raises
        ------
        ValueError
            before `situate`
        """
        return self._solution()[0]

    def _solution(self) -> tuple[GaussianMixture, Smooth, Spread]:
        if self._solved is None:
            raise ValueError("there is no situation yet: call situate(frames) first")
        return self._solved
