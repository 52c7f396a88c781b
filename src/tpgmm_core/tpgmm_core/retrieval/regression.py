# SPDX-License-Identifier: Apache-2.0
"""Time-driven regression (GMR) in both orders: the Gaussian of the movement at any of the model's times.

The orders are the same for one component. Where several are active they differ:

- Adapting first treats time as any other dimension. P frames that see the same times make the components' variances in
  time P times smaller, so that they take over from one another in shorter time. Since times are correlated with places,
  frames that contradict each other on where a component is move it in time as well. Frames are weighed component by
  component.
- Regressing first keeps the transitions as learned, hence is smoother. The spread between the means of active
  components counts as uncertainty of that frame at that time, so that frames are weighed time by time.

The farther a situation is from the demonstrated ones, the more frames contradict each other, and the orders differ.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.disagreement import no_product
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model import kernels_regress
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE, Adapter
from tpgmm_core.model.frame_buffer import FrameBuffer
from tpgmm_core.model.kernels_adapt import adapt
from tpgmm_core.retrieval.frames import require_time_kept
from tpgmm_core.retrieval.interface import TimeParametrized, demonstrated_duration


class _Regression(TimeParametrized):
    """What both orders share: all of `TimeParametrized` except `situate`, `at` and `mixture`.

    Parameters
    ----------
    model
        fitted, with time as the first dimension, s
    buffer
        for the frames of a situation

    Raises
    ------
    ValueError
        for a model without time
    """

    def __init__(self, model: LearnedMixture, buffer: FrameBuffer) -> None:
        self._buffer = buffer
        for name, manifold in model.frame_manifolds_.items():
            if manifold.factors[0][0] != "R" or manifold.tangent_dim < 2:
                raise ValueError(
                    f"regression needs time as the first dimension, then others; frame {name!r} is {manifold}"
                )
        self.model = model
        self._space = model.manifold_
        self._data_space = _data_manifold(model.manifold_)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""
        return self.model.frame_names_

    @property
    def duration(self) -> float:
        """Duration of the demonstrations, s. Raises ValueError when the model's metadata do not say."""
        return demonstrated_duration(self.model)

    @property
    def manifold(self) -> Manifold:
        """Manifold of the data, without time; on R^D it is what the frames of the situation map to."""
        space = self._buffer.manifold
        if space is not self._space:
            self._space, self._data_space = space, _data_manifold(space)
        return self._data_space

    def retrieve(
        self,
        frames: Mapping[str, Frame],
        times: ArrayLike,
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> list[Gaussian]:
        """The movement in a situation, one Gaussian without time for each of the times.

        Parameters
        ----------
        frames
            as for `situate`
        times
            (T,), s
        state, weights
            as for `situate`

        Raises
        ------
        ValueError
            like `situate`, and for times that are not finite
        """
        times = np.array(times, dtype=float)
        if times.ndim != 1 or len(times) == 0 or not np.all(np.isfinite(times)):
            raise ValueError(f"times have shape (T,) with T > 0 and are finite, got {times!r}")
        self.situate(frames, None if state is None else np.asarray(state, dtype=float), weights)
        means, covariances, _ = self.at(times)
        return [Gaussian(mean, S, self.manifold) for mean, S in zip(means, covariances, strict=True)]


class AdaptThenRegress(_Regression):
    """Eqs. (5) and (6), then regression on the first dimension."""

    def __init__(self, model: LearnedMixture) -> None:
        self._adapter = Adapter(model)
        super().__init__(model, self._adapter.buffer)

    def situate(
        self, frames: Mapping[str, Frame], state: ArrayLike | None = None, weights: Mapping[str, float] | None = None
    ) -> None:
        """Adapt the mixture to this situation."""
        self._adapter.situate(frames, _with_time(state), weights)
        require_time_kept(self._buffer)

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Regression on the adapted mixture at times (H,), s."""
        return self._adapter.condition(times)

    def mixture(self) -> GaussianMixture:
        """The adapted mixture, over [time, data]."""
        return self._adapter.mixture()


class RegressThenProduct(_Regression):
    """Regression on the first dimension in each frame, then the product of Eq. (6) at each time.

    Activations are the mean over the frames, which differ where frames were not seen all the time.
    """

    def __init__(self, model: LearnedMixture) -> None:
        super().__init__(model, FrameBuffer(model))
        sizes = self._buffer.sizes
        P, K = len(sizes), len(model.priors_)
        D_max, n_max = (int(size) for size in sizes.max(axis=0))
        self._log_priors = np.log(np.maximum(model.priors_, np.finfo(float).tiny))
        means, covariances = np.zeros((P, K, D_max)), np.zeros((P, K, n_max, n_max))
        for j, name in enumerate(self.frame_names):
            D, n = sizes[j]
            means[j, :, :D], covariances[j, :, :n, :n] = model.means_[name], model.covariances_[name]
        flat = np.arange(n_max) if model.manifold_.is_euclidean else model.manifold_.ambient_of_tangent
        self._data_sizes = sizes - 1
        self._views = self._log_priors, means, covariances, sizes, flat, model.manifold_.sphere_starts
        self.situate(self._buffer.identity_frame())
        self.at(np.zeros(1))  # compiled, or loaded from the cache

    def situate(
        self, frames: Mapping[str, Frame], state: ArrayLike | None = None, weights: Mapping[str, float] | None = None
    ) -> None:
        """Keep the frames, weights and state of this situation for `at`."""
        self._buffer.take(frames, _with_time(state), weights)
        require_time_kept(self._buffer)
        self._A = np.ascontiguousarray(self._buffer.A[:, 1:, 1:])
        self._b = np.ascontiguousarray(self._buffer.b[:, 1:])
        self._inverses = np.ascontiguousarray(self._buffer.inverses[:, 1:, 1:])

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Regression in each frame at times (H,), s, and the product over the frames.

        Raises
        ------
        ValueError
            for a singular covariance, and where the frames contradict each other so much that there is no product
        """
        seen, precisions = self._views_for(len(times))
        activations = np.empty(len(self._log_priors))
        failed = kernels_regress.regress_views(*self._views, self._buffer.weights, times, seen, precisions, activations)
        self._refuse_singular(failed)
        return *self._product(times, seen, precisions), activations

    def _refuse_singular(self, failed: int) -> None:
        """Raise ValueError for the frame of this index, unless it is -1."""
        if failed >= 0:
            name = self.frame_names[failed]
            raise ValueError(f"the covariances of frame {name!r} are singular: fit with a larger reg_covar")

    def _views_for(self, H: int) -> tuple[Array, Array]:
        """What each frame sees at H times, still to be written: means (P, D, H) and precisions (P, n, n H)."""
        D, n = self._data_sizes.max(axis=0)
        P = len(self._data_sizes)
        return np.zeros((P, D, H)), np.zeros((P, n, n * H))

    def _product(self, times: Array, seen: Array, precisions: Array) -> tuple[Array, Array]:
        """The product over the frames of what they see at each time, means (H, D) and covariances (H, n, n)."""
        s, manifold = self._buffer, self.manifold
        H, n = len(times), manifold.tangent_dim
        means, covariances = np.empty((H, manifold.dim)), np.empty((H, n, n))
        failed = adapt(
            *(seen, precisions, self._data_sizes, manifold.ambient_of_tangent, manifold.sphere_starts),
            *(self._A, self._b, self._inverses, s.has_inverse, s.pose_covariances, s.weights, s.state[1:].copy()),
            *(1.0 / UNCONSTRAINED_VARIANCE, means, covariances),
        )
        if failed < -1:
            raise no_product(f"the time {times[-2 - failed]:.3g} s", self._views_at(times[-2 - failed]))
        if failed >= 0:
            s.refuse(failed)
        return means, covariances

    def _views_at(self, time: float) -> dict[str, Gaussian]:
        """Gaussians that the known frames expect at a time, in the common frame."""
        s, model = self._buffer, self.model
        views = {}
        for j in np.flatnonzero(s.weights):
            name = self.frame_names[j]
            seen = GaussianMixture(model.priors_, model.means_[name], model.covariances_[name], model.manifold_)
            views[name] = seen.condition([0], [time]).transform(Frame(self._A[j], self._b[j]))
        return views

    def mixture(self) -> GaussianMixture:
        """The mixture adapted to this situation, over [time, data]."""
        s = self._buffer
        frames = {name: s.frame(j) for j, name in enumerate(self.frame_names)}
        weights = dict(zip(self.frame_names, s.weights.tolist(), strict=True))
        return self.model.adapt(frames, s.state, weights)


def _with_time(state: ArrayLike | None) -> Array | None:
    return None if state is None else np.concatenate([[0.0], np.asarray(state, dtype=float)])


def _data_manifold(manifold: Manifold) -> Manifold:
    return manifold.subset(range(1, manifold.dim))
