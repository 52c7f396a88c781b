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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.kernels import invert_side_by_side
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.kernels_regress import spread_at
from tpgmm_core.retrieval.differences import difference_weights
from tpgmm_core.retrieval.dynamic_features import point_manifold, standing_frames
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.interpolation import interpolate
from tpgmm_core.retrieval.smoothing import Smooth, smoothest

WARM_TURN = 0.2
"""A course begins at its former solution where no state turned by more than this, rad: from there it finds the same."""
WARM_TOLERANCE = 1e-5
"""Steps from a former solution end below this, rad: what is left out is less than a thousandth of it."""


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
        smooth = _smoothest(seen_as_it_is, grid, difference_weights(grid), states)
        _spread(seen_as_it_is, grid, self.activations(grid), _interpolated(grid, smooth, manifold, grid))

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
        smooth = _smoothest(mixture, times, windows, chosen.astype(np.intp))
        covariances = _spread(mixture, times, activations, smooth.points)
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
        differences = times[:, None, None] - self._times
        log_densities = -0.5 * (differences**2 / self._variances + np.log(self._variances))
        log_joint = self._log_priors + log_densities.mean(axis=1)
        activations = np.exp(log_joint - log_joint.max(axis=1, keepdims=True))
        return np.asarray(activations / activations.sum(axis=1, keepdims=True))

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
        self._solved: tuple[GaussianMixture, Smooth] | None = None

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
        former = None
        if self._solved is not None and self._are_near(self._solved[0], mixture):
            former = self._solved[1].points
        self._solved = mixture, _smoothest(mixture, self._grid, self._windows, self._states, former)

    def _are_near(self, one: GaussianMixture, other: GaussianMixture) -> bool:
        """Whether no state turned by more than WARM_TURN. How far positions moved does not matter: they are linear."""
        blocks = [slice(1 + s.ambient.start, 1 + s.ambient.stop) for s in self.manifold.spheres]
        cosines = [np.abs((one.means[:, block] * other.means[:, block]).sum(axis=1)).min() for block in blocks]
        return all(cosine > math.cos(0.5 * WARM_TURN) for cosine in cosines)

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
        mixture, smooth = self._solution()
        times = np.asarray(times, dtype=float)
        means = _interpolated(self._grid, smooth, self.manifold, times)
        within = np.clip(times, self._grid[0], self._grid[-1])
        activations = self._model.activations(within)
        first = activations[0] if within[0] == times[0] else self._model.activations(times[:1])[0]
        return means, _spread(mixture, within, activations, means), first

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

    def _solution(self) -> tuple[GaussianMixture, Smooth]:
        if self._solved is None:
            raise ValueError("there is no situation yet: call situate(frames) first")
        return self._solved


def _smoothest(
    mixture: GaussianMixture,
    times: Array,
    windows: tuple[NDArray[np.intp], Array],
    states: NDArray[np.intp],
    former: Array | None = None,
) -> Smooth:
    """`smoothest` for a mixture over [time, position, velocity, acceleration]; from former points (T, D) if given."""
    covariances = np.ascontiguousarray(np.moveaxis(mixture.covariances[:, 1:, 1:], 0, -1))
    precisions = np.empty(covariances.shape[-1:] + covariances.shape[:2])
    invert_side_by_side(covariances, np.empty(covariances.shape), precisions)
    means = np.ascontiguousarray(mixture.means[:, 1:])
    manifold = point_manifold(mixture.manifold)
    if former is not None:
        return smoothest(*windows, means, precisions, states, manifold, former, WARM_TOLERANCE)
    start = _between(times, states, means[:, : manifold.dim], manifold)
    return smoothest(*windows, means, precisions, states, manifold, start)


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


def _spread(mixture: GaussianMixture, times: Array, activations: Array, positions: Array) -> Array:
    """Covariances (T, n, n) at smooth positions (T, D): see the module. activations (T, K)."""
    points = point_manifold(mixture.manifold)
    D, n = points.dim, points.tangent_dim
    seen = mixture.manifold.subset(range(1 + D))
    means, within = mixture.means[:, : 1 + D], mixture.covariances[:, : 1 + n, : 1 + n]
    covariances = np.empty((len(times), n, n))
    spread_at(
        activations, np.ascontiguousarray(means), np.ascontiguousarray(within), times, positions,
        seen.ambient_of_tangent, seen.sphere_starts, points.ambient_of_tangent, points.sphere_starts, covariances,
    )  # fmt: skip
    return covariances


def _interpolated(grid: Array, smooth: Smooth, manifold: Manifold, times: Array) -> Array:
    means = np.empty((len(times), manifold.dim))
    layout = manifold.ambient_of_tangent, manifold.sphere_starts
    interpolate(grid, smooth.points, smooth.velocities, *layout, times, means)
    return means
