# SPDX-License-Identifier: Apache-2.0
"""Trajectory models with dynamic features (Tokuda et al. 2000; Zen, Tokuda and Kitamura 2007).

Position, velocity and acceleration are learned together. At each time one component, the state, says what all three
should be, with the precision that it learned; the trajectory is that whose positions, velocities and accelerations
are all together the most likely, hence smooth although states change at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from tpgmm_core.adaptation import Adapter
from tpgmm_core.demonstration import Demonstration
from tpgmm_core.frame import Frame
from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold
from tpgmm_core.mixture import GaussianMixture
from tpgmm_core.quaternion import Array
from tpgmm_core.retrieval.banded import inverse_band
from tpgmm_core.retrieval.differences import derivatives, difference_weights
from tpgmm_core.retrieval.frames import without_time
from tpgmm_core.tpgmm import TPGMM

MAX_REFINEMENTS = 10
ILL_CONDITIONED = (
    "the precisions of positions and accelerations are too different for times so close together: take longer time "
    "steps, or a larger reg_covar"
)


def with_derivatives(demonstration: Demonstration, window: int = 9) -> Demonstration:
    """The demonstration with velocities and accelerations, for a `TPGMM` that `TrajectoryModel` retrieves from.

    demonstration : data (T, 1 + d): time, then positions; Euclidean, in frames that do not move
    window : samples of the parabolas that the derivatives are taken from (`difference_weights`); demonstrations of
        fewer samples take as many as they have

    Data become (T, 1 + 3d): time, positions, velocities (1/s), accelerations (1/s²). A frame x = A y + b acts on all
    alike, with A, and b for the positions only. Raises ValueError for frames that move or change time, and less than
    three samples.
    """
    data = demonstration.data
    frames = _dynamic_frames(demonstration.frames)
    positions = data[:, 1:]
    window = min(window, (len(data) - 1) // 2 * 2 + 1)
    velocities, accelerations = derivatives(
        demonstration.times, positions, Manifold.euclidean(positions.shape[1]), window
    )
    return Demonstration(
        demonstration.times,
        np.column_stack([data[:, 0], positions, velocities, accelerations]),
        frames,
        demonstration.visible,
    )


def _dynamic_frames(frames: Mapping[str, Frame]) -> dict[str, Frame]:
    moving = [name for name, frame in frames.items() if frame.is_time_varying]
    if moving:
        raise ValueError(
            f"the frames {moving} vary with time, so that velocities would not be seen from them as positions are: "
            "give frames that stand still, e.g. frame.at(0)"
        )
    result = {}
    for name, frame in without_time(frames).items():
        b = np.concatenate([frame.b, np.zeros(2 * len(frame.b))])
        result[name] = Frame(np.asarray(np.kron(np.eye(3), frame.A), dtype=float), b).with_time()
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A smooth trajectory of T steps in d dimensions.

    times : (T,), s; states : (T,), the component that held at each; positions : (T, d)
    velocities, accelerations : (T, d), the differences of the positions that the model was compared to
    covariances : (T, d, d), of the positions; each takes all other steps into account
    """

    times: Array
    states: NDArray[np.intp]
    positions: Array
    velocities: Array
    accelerations: Array
    covariances: Array

    @property
    def gaussians(self) -> list[Gaussian]:
        """The Gaussian of the position at each time."""
        return [Gaussian(x, S) for x, S in zip(self.positions, self.covariances, strict=True)]


class TrajectoryModel:
    """Retrieves smooth trajectories from a model of positions, velocities and accelerations.

    model : fitted to what `with_derivatives` returns, (time, positions, velocities, accelerations)

    Raises ValueError for a model on S³, or of another number of dimensions.
    """

    def __init__(self, model: TPGMM) -> None:
        manifold = model.manifold_
        if not manifold.is_euclidean or manifold.dim < 4 or manifold.dim % 3 != 1:
            raise ValueError(
                "a trajectory model is Euclidean and has 1 + 3 d dimensions: time, d positions, d velocities, d "
                f"accelerations (see with_derivatives), got {manifold}"
            )
        self._adapter = Adapter(model)
        ones = np.ones((1, 1))
        inverse_band(ones, ones.copy())  # compiled, or loaded from the cache

    def retrieve(
        self,
        frames: Mapping[str, Frame],
        times: ArrayLike,
        states: Sequence[int] | NDArray[np.intp] | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Trajectory:
        """The trajectory in a situation, in time linear in its length.

        frames : over [time, position] (`Frame.with_time`), at least one of the model's; none moves
        times : (T,), T >= 3, s, increasing
        states : (T,), the component that holds at each time; the most active one at that time where None
        weights : how far each frame is trusted, 0 to 1; fully where not named

        Raises ValueError like `Adapter.adapt`, and for times and states that do not fit.
        """
        mixture = self._adapter.adapt(_dynamic_frames(frames), weights=weights)
        times = np.asarray(times, dtype=float)
        first, weights_of = difference_weights(times)
        K = len(mixture.priors)
        if states is None:
            chosen = most_active(mixture, times)
        else:
            chosen = np.asarray(states)
            is_index = chosen.shape == times.shape and np.issubdtype(chosen.dtype, np.integer)
            if not is_index or chosen.min() < 0 or chosen.max() >= K:
                raise ValueError(f"states are {len(times)} integers 0 to {K - 1}, one for each time, got {states!r}")
        spatial = range(1, mixture.manifold.dim)
        parts = [mixture.component(k).marginal(spatial) for k in range(K)]
        means, precisions = np.stack([p.mean for p in parts]), np.stack([p.precision for p in parts])
        positions, covariances = smoothest(first, weights_of, means[chosen], precisions[chosen])
        _, velocities, accelerations = np.moveaxis(with_differences(first, weights_of, positions), 1, 0)
        return Trajectory(times, chosen, positions, velocities, accelerations, covariances)


def most_active(mixture: GaussianMixture, times: Array) -> NDArray[np.intp]:
    """The component (T,) that regression on the first dimension would weigh most at each of the times (T,)."""
    return np.argmax(mixture.responsibilities([0], times[:, None]), axis=0)


def smoothest(first: NDArray[np.intp], weights: Array, means: Array, precisions: Array) -> tuple[Array, Array]:
    """Positions (T, d) that minimise the sum over t of |W_t x - means[t]|² in precisions[t], and their covariances.

    first, weights : of `difference_weights`, which make up W_t; means : (T, 3 d); precisions : (T, 3 d, 3 d)

    The normal equations W^T Lambda W x = W^T Lambda mu (Zen et al. 2007) couple a step with two neighbours on each side
    only. The covariances (T, d, d) are the diagonal blocks of (W^T Lambda W)^-1, whose condition grows with the number
    of steps per state to the fourth power: at some hundreds of steps per state they are good to four digits, the
    positions to all. Raises ValueError when rounding leaves nothing definite.
    """
    T, d = len(first), means.shape[1] // 3
    index = (first[:, None] + np.arange(3))[..., None] * d + np.arange(d)  # (T, 3, d): the unknowns that W_t takes
    factor = _factorised(index, weights, precisions)
    # Squaring W costs half of the digits. What the solution leaves over is found without squaring, and solved for again
    positions = np.tile(means[:, :d].mean(axis=0), (T, 1))
    for _ in range(MAX_REFINEMENTS):
        left_over = means - with_differences(first, weights, positions).reshape(T, 3 * d)
        forces = np.einsum("tij,tj->ti", precisions, left_over).reshape(T, 3, d)
        right = np.zeros(T * d)
        np.add.at(right, index, np.einsum("atp,tai->tpi", weights, forces))
        step = cho_solve_banded((factor, True), right).reshape(T, d)
        positions += step
        extent, rounding = np.ptp(positions, axis=0).max(), 4.0 * np.finfo(float).eps * np.abs(positions).max()
        if np.abs(step).max() <= max(1e-11 * extent, rounding):
            break
    else:
        raise ValueError(ILL_CONDITIONED)
    inverse = np.zeros_like(factor)
    inverse_band(factor, inverse)
    covariances = np.empty((T, d, d))
    for i in range(d):
        for j in range(i + 1):
            covariances[:, i, j] = covariances[:, j, i] = inverse[i - j, j::d]
    return positions, covariances


def with_differences(first: NDArray[np.intp], weights: Array, positions: Array) -> Array:
    """W x: positions (T, d), and their velocities and accelerations by differences, as (T, 3, d)."""
    steps = positions[first[:, None] + np.arange(3)] - positions[:, None]
    result = np.einsum("atp,tpi->tai", weights, steps)
    result[:, 0] = positions
    return result


def _factorised(index: NDArray[np.intp], weights: Array, precisions: Array) -> Array:
    """Banded Cholesky factor (3 d, T d) of W^T Lambda W, in the lower form of scipy."""
    T, _, d = index.shape
    blocks = precisions.reshape(T, 3, d, 3, d)
    terms = np.einsum("atp,btq,taibj->tpiqj", weights, weights, blocks, optimize=True)
    row, column = np.broadcast_arrays(index[:, :, :, None, None], index[:, None, None, :, :])
    lower = row >= column
    band = np.zeros((3 * d, T * d))
    np.add.at(band, (row[lower] - column[lower], column[lower]), terms[lower])
    try:
        return np.asarray(cholesky_banded(band, lower=True))
    except np.linalg.LinAlgError:
        raise ValueError(ILL_CONDITIONED) from None
