# SPDX-License-Identifier: Apache-2.0
"""Trajectory models with dynamic features (Tokuda et al. 2000; Zen, Tokuda and Kitamura 2007).

Position, velocity and acceleration are learned together. At each time one component, the state, says what all three
should be, with the precision that it learned; the trajectory is the one whose positions, velocities and accelerations
together are the most probable, hence smooth although states change suddenly.

The sum that is minimised counts each time step as an observation of its own. This leads to the right mean, since a
factor on the whole sum moves no minimum. But the inverse of its Hessian is no covariance of the movement: N times as
many steps are N times the information, and make the variance N times smaller, however few demonstrations there were.
How far demonstrations are apart at a time t is what the mixture says at t, sum_k h_k(t) N(m_k(t), S_k(t)), with h_k the
activations and N(m_k(t), S_k(t)) the position of component k given the time. Its covariance, by the law of total
covariance, is

    sum_k h_k(t) (S_k(t) + (m_k(t) - m(t)) (m_k(t) - m(t))^T),   m(t) = sum_k h_k(t) m_k(t),

the spread within components and between them, here moved from m(t) to the smooth position by parallel transport. It is
what regression says, with the activations as learned. The number of steps does not occur in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.retrieval import kernels_trajectory as kernels
from tpgmm_core.retrieval.differences import difference_weights
from tpgmm_core.retrieval.dynamic_features import point_manifold, standing_frames
from tpgmm_core.retrieval.situated_trajectory import Spread, interpolated, smoothest_of


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A smooth trajectory of T steps on a manifold of D ambient and n tangent dimensions.

    Parameters
    ----------
    times
        (T,), s
    states
        (T,), the component at each time
    positions
        (T, D), signs of quaternions continuous
    velocities, accelerations
        (T, n), the differences of the positions that were compared with the model
    covariances
        (T, n, n), in the tangent spaces at the positions: how far demonstrations are apart at that time (see the
        module), independent of the number of steps
    manifold
        of the positions
    iterations
        number of Gauss-Newton steps
    """

    times: Array
    states: NDArray[np.intp]
    positions: Array
    velocities: Array
    accelerations: Array
    covariances: Array
    manifold: Manifold
    iterations: int

    @property
    def gaussians(self) -> list[Gaussian]:
        """The Gaussian of the position at each time."""
        return [Gaussian(x, S, self.manifold) for x, S in zip(self.positions, self.covariances, strict=True)]


class TrajectoryModel:
    """Retrieves whole smooth trajectories from a model of positions, velocities and accelerations.

    Parameters
    ----------
    model
        fitted to what `with_derivatives` returns, on `manifold_with_derivatives`

    Raises
    ------
    ValueError
        for a model of other dimensions
    """

    def __init__(self, model: LearnedMixture) -> None:
        point_manifold(model.manifold_)
        self._adapter = Adapter(model)
        self._log_priors = np.log(np.maximum(model.priors_, np.finfo(float).tiny))
        self._times = np.stack([means[:, 0] for means in model.means_.values()])
        self._variances = np.stack([covariances[:, 0, 0] for covariances in model.covariances_.values()])
        self._compile(model)

    def _compile(self, model: LearnedMixture) -> None:
        """Compute one solution and one interpolation, so that no later one waits for the compiler."""
        name, view = next(iter(model.frame_manifolds_.items()))
        seen_as_it_is = GaussianMixture(model.priors_, model.means_[name], model.covariances_[name], view)
        manifold = point_manifold(view)
        states = np.zeros(3, dtype=np.intp)
        grid = np.arange(3.0)
        smooth = smoothest_of(seen_as_it_is, grid, difference_weights(grid), states)
        points = interpolated(grid, smooth, manifold, grid)
        Spread(seen_as_it_is).at(grid, self.activations(grid), points)
        means = np.array(seen_as_it_is.means, order="C")
        kernels.least_cosine(means, means, 1, manifold.sphere_starts)

    def retrieve(
        self,
        frames: Mapping[str, Frame],
        times: ArrayLike,
        states: Sequence[int] | NDArray[np.intp] | None = None,
        weights: Mapping[str, float] | None = None,
        state: ArrayLike | None = None,
    ) -> Trajectory:
        """The trajectory in a situation, in time linear in its length.

        Parameters
        ----------
        frames
            over [time, position] (`Frame.with_time`), at least one of the model's; none moves
        times
            (T,), T >= 3, s, increasing
        states
            (T,), the component at each time, which alone is active then; None: the most active one (`states`), while
            the covariances take all active ones into account
        weights
            how far each frame is trusted, 0 to 1; 1 where not named
        state
            (D,), where the robot is: what no frame constrains stays there; the origin where None

        Returns
        -------
        Trajectory
            positions, velocities, accelerations and covariances at the times

        Raises
        ------
        ValueError
            like `Adapter.adapt` and `smoothest`, and for times and states that do not fit
        """
        mixture = self.adapt(frames, state, weights)
        times = np.asarray(times, dtype=float)
        windows = difference_weights(times)
        K = len(mixture.priors)
        if states is None:
            activations = self.activations(times)
            chosen = activations.argmax(axis=1)
        else:
            chosen = np.asarray(states)
            is_index = chosen.shape == times.shape and np.issubdtype(chosen.dtype, np.integer)
            if not is_index or chosen.min() < 0 or chosen.max() >= K:
                raise ValueError(f"states are {len(times)} integers 0 to {K - 1}, one for each time, got {states!r}")
            activations = np.eye(K)[chosen]
        smooth = smoothest_of(mixture, times, windows, chosen.astype(np.intp))
        covariances = Spread(mixture).at(times, activations, smooth.points)
        manifold = point_manifold(mixture.manifold)
        for s in manifold.spheres:
            smooth.points[:, s.ambient] = quaternion.continuous(smooth.points[:, s.ambient])
        return Trajectory(
            times, chosen, smooth.points, smooth.velocities, smooth.accelerations, covariances, manifold,
            smooth.iterations,
        )  # fmt: skip

    @property
    def manifold(self) -> Manifold:
        """Manifold of the positions."""
        return point_manifold(self._adapter.manifold)

    def activations(self, times: Array) -> Array:
        """Activations of the components as learned: geometric means over the frames.

        Not those of the adapted mixture: frames that contradict each other on where a component is move it in time too.

        Parameters
        ----------
        times
            of the model, (T,)

        Returns
        -------
        Array
            shape (T, K)
        """
        activations = np.empty((len(times), self._times.shape[1]))
        kernels.activate(self._log_priors, self._times, self._variances, np.array(times, dtype=float), activations)
        return activations

    def states(self, times: Array) -> NDArray[np.intp]:
        """The most active component (T,) at each of the model's times (T,)."""
        return np.argmax(self.activations(times), axis=1)

    def adapt(
        self,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> GaussianMixture:
        """The mixture in a situation.

        Parameters
        ----------
        frames, state, weights
            as for `retrieve`

        Returns
        -------
        GaussianMixture
            over [time, position, velocity, acceleration]
        """
        points = self.manifold
        if state is not None:
            state = np.concatenate([[0.0], np.asarray(state, dtype=float), np.zeros(2 * points.tangent_dim)])
        return self._adapter.adapt(standing_frames(frames, points), state, weights)
