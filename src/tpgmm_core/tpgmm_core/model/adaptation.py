# SPDX-License-Identifier: Apache-2.0
"""`Adapter`: a fitted model, prepared to meet new frames again and again (Eqs. 5 and 6)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.disagreement import no_product
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.model import kernels_adapt, kernels_regress
from tpgmm_core.model.fitted import FittedModel, check_fitted
from tpgmm_core.model.frame_buffer import FrameBuffer
from tpgmm_core.model.learned import Learned

UNCONSTRAINED_VARIANCE = 1e6
"""Variance, in squared units of the data, with which a direction that no frame constrains stays at the state.

Where the frames are less certain than this, the missing precision is added, so that a frame whose weight fades to
zero leaves without a jump; more certain directions (standard deviations below 1000 units) are not
changed at all.
"""


class Adapter:
    """A fitted model with its precisions computed ahead, which is adapted to new frames again and again.

    It makes the mixture in a new situation, or regression on it. In precision form frame j contributes weight_j
    (A_j^+)^T Lambda_j A_j^+ at A_j mu_j + b_j, for any A: it says nothing about directions outside the range of its A.
    A frame's own inverse (`Frame.inverse`) takes the place of A_j^+. The constructor compiles everything, so that no
    later step waits for the compiler.

    Parameters
    ----------
    model
        a fitted model, such as `TPGMM`; what is needed of it is copied

    Raises
    ------
    ValueError
        for a model that is not fitted, and covariances that are not positive definite
    """

    def __init__(self, model: FittedModel) -> None:
        check_fitted(model)
        self.learned = Learned(model)  # before anything is read from it
        self.frame_names = model.frame_names_
        self.priors = np.array(model.priors_, dtype=float)
        manifolds = model.frame_manifolds_
        P, K = len(self.frame_names), len(model.priors_)
        D_max = max(m.dim for m in manifolds.values())
        n_max = max(m.tangent_dim for m in manifolds.values())
        self._log_priors = np.log(np.maximum(self.priors, np.finfo(float).tiny))
        self.buffer = FrameBuffer(model)
        self._means = np.zeros((P, D_max, K))
        self._precisions = np.zeros((P, n_max, n_max * K))
        for j, name in enumerate(self.frame_names):
            D_j, n_j = self.buffer.sizes[j]
            self._means[j, :D_j] = model.means_[name].T
            precisions = _precisions(name, model.means_[name], model.covariances_[name])
            self._precisions[j, :n_j, : n_j * K].reshape(n_j, n_j, K)[:] = np.moveaxis(precisions, 0, -1)
        self._means_out, self._covariances_out = np.zeros((K, 0)), np.zeros((K, 0, 0))
        self._arrays: tuple[NDArray[Any], ...] | None = None
        if self.manifold.tangent_dim > 1:
            self._compile()

    @property
    def manifold(self) -> Manifold:
        """The space that the frames map to."""
        return self.buffer.manifold

    def _compile(self) -> None:
        """Make one step with one frame at the origin."""
        self.situate(self.buffer.identity_frame())
        if self.manifold.ambient_of_tangent[0] == 0:
            self.condition(np.zeros(1))

    def adapt(
        self,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> GaussianMixture:
        """The mixture with means and covariances of Eq. (6), in the space that the frames map to.

        Parameters
        ----------
        frames
            any of the model's frames by name, at least one; those that are missing contribute nothing, and those whose
            pose is not known exactly (`Frame.pose_covariance`) less, in the directions in which it is not
        state
            shape (D,), where the robot is; zeros (and no turn) where None. A direction that no frame constrains stays
            there, with UNCONSTRAINED_VARIANCE
        weights
            how far each frame is trusted, 0 to 1; 1 where not named

        Returns
        -------
        GaussianMixture
            over the frames' common space, with the model's priors

        Raises
        ------
        ValueError
            for unknown names, matrices that do not fit, time-varying frames, weights outside 0..1, and orientations so
            contradictory that their product does not converge (`kernels_product.fuse`)
        """
        self.buffer.take(frames, state, weights)
        inputs = self._inputs()
        means, covariances = np.empty(self._means_out.shape), np.empty(self._covariances_out.shape)
        self._check(kernels_adapt.adapt(*inputs, 1.0 / UNCONSTRAINED_VARIANCE, means, covariances))
        return GaussianMixture._made(self.priors.copy(), means, covariances, self.buffer.manifold)

    def situate(
        self,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        """Adapt to a situation without returning it: `condition` and `mixture` then read from it.

        Parameters
        ----------
        frames, state, weights
            as for `adapt`

        Raises
        ------
        ValueError
            like `adapt`
        """
        self.buffer.take(frames, state, weights)
        self._check(kernels_adapt.adapt(*self._inputs(), *self._result()))

    def mixture(self) -> GaussianMixture:
        """The mixture in the situation of the last call."""
        return GaussianMixture._made(
            self.priors.copy(), self._means_out.copy(), self._covariances_out.copy(), self.manifold
        )

    def adapt_and_condition(
        self,
        frames: Mapping[str, Frame],
        times: ArrayLike,
        weights: Mapping[str, float] | None = None,
        state: ArrayLike | None = None,
    ) -> tuple[Array, Array, Array]:
        """One step of a reproduction: adapt, then regression on the first dimension.

        Parameters
        ----------
        frames
            as for `adapt`
        times
            shape (H,), values of the first dimension
        weights, state
            as for `adapt`

        Returns
        -------
        tuple[Array, Array, Array]
            means (H, D - 1), covariances (H, n - 1, n - 1) and the components' activations (K,) at the first of the
            times, the same as `adapt(...).condition([0], [t])`

        Raises
        ------
        ValueError
            like `adapt`
        """
        self.situate(frames, state, weights)
        return self.condition(times)

    def condition(self, times: ArrayLike) -> tuple[Array, Array, Array]:
        """Regression in the situation of the last call, without adapting to it again.

        Parameters
        ----------
        times
            shape (H,), values of the first dimension

        Returns
        -------
        tuple[Array, Array, Array]
            as of `adapt_and_condition`
        """
        times = np.array(times, dtype=float)  # of one type for the compiled code
        means, covariances, activations = outputs = self._outputs(len(times))
        kernels_regress.regress_all(
            self._log_priors, self._means_out, self._covariances_out, *self.buffer.layout, times, *outputs
        )
        return means, covariances, activations[0]

    def _outputs(self, H: int) -> tuple[Array, Array, Array]:
        """Means, covariances and activations of a regression at H times, still to be filled in."""
        manifold = self.manifold
        if manifold.ambient_of_tangent[0] != 0 or manifold.tangent_dim < 2:
            raise ValueError(f"regression over time needs time as the first dimension, then others, got {manifold}")
        n = manifold.tangent_dim - 1
        return np.empty((H, manifold.dim - 1)), np.empty((H, n, n)), np.empty((H, len(self.priors)))

    def _inputs(self) -> tuple[NDArray[Any], ...]:
        """What `kernels_adapt.adapt` reads, of the situation that was taken last."""
        s = self.buffer
        if self._arrays is None or s.A is not self._arrays[5]:  # frames that map to another space have other arrays
            K, D, n = len(self.priors), s.manifold.dim, s.manifold.tangent_dim
            self._means_out, self._covariances_out = np.zeros((K, D)), np.zeros((K, n, n))
            frames = s.A, s.b, s.inverses, s.has_inverse, s.pose_covariances, s.weights
            self._arrays = self._means, self._precisions, s.sizes, *s.layout, *frames
        return *self._arrays, s.state

    def _result(self) -> tuple[float, Array, Array]:
        return 1.0 / UNCONSTRAINED_VARIANCE, self._means_out, self._covariances_out

    def _check(self, failed: int) -> None:
        if failed < -1:
            raise no_product(f"component {-2 - failed}", self._views(-2 - failed))
        if failed >= 0:
            self.buffer.refuse(failed)

    def _views(self, k: int) -> dict[str, Gaussian]:
        """Component k as each known frame sees it, in the common frame; on S³ these have one manifold."""
        s, K = self.buffer, len(self.priors)
        views = {}
        for j in np.flatnonzero(s.weights):
            D_j, n_j = s.sizes[j]
            covariance = np.linalg.inv(self._precisions[j, :n_j, k : n_j * K : K])
            seen = Gaussian(self._means[j, :D_j, k], covariance, s.manifold)
            views[self.frame_names[j]] = seen.transform(s.frame(int(j)))
        return views


def _precisions(name: str, means: Array, covariances: Array) -> Array:
    """Inverse covariances (K, n, n) of the frame `name`. Raises ValueError where there are none."""
    if not (np.all(np.isfinite(means)) and np.all(np.isfinite(covariances))):
        raise ValueError(f"the means and covariances of frame {name!r} must be finite")
    asymmetry = np.abs(covariances - np.swapaxes(covariances, 1, 2)).max(axis=(1, 2))
    if np.any(asymmetry > 1e-8 * np.abs(covariances).max(axis=(1, 2))):
        raise ValueError(f"the covariances of frame {name!r} must be symmetric")
    try:
        factors = np.linalg.inv(np.linalg.cholesky(covariances))
    except np.linalg.LinAlgError:
        raise ValueError(f"the covariances of frame {name!r} are not positive definite") from None
    return np.swapaxes(factors, 1, 2) @ factors
