# SPDX-License-Identifier: Apache-2.0
"""Time-driven regression (GMR) in both orders: the Gaussian of the movement at each of some times.

The orders are the same for one component. Where several are active they differ:

- Adapting first treats time as any other dimension. P frames that see the same times make the components' variances in
  time P times smaller, so that they take over from one another in shorter time. Since times go with places, frames
  that contradict each other on where a component is move it in time as well. Frames are weighed component by component.
- Regressing first keeps the transitions as learned, hence is smoother. The spread between the means of active
  components counts as uncertainty of that frame at that time, so that frames are weighed time by time. Nothing but the
  product depends on the situation: regression is done once, ahead.

The farther a situation is from the demonstrated ones, the more frames contradict each other, and the orders too.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core import kernels_regress
from tpgmm_core.adaptation import Adapter
from tpgmm_core.frame import Frame
from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold
from tpgmm_core.quaternion import Array
from tpgmm_core.retrieval.frames import without_time
from tpgmm_core.tpgmm import TPGMM


class AdaptThenRegress:
    """Eqs. (5) and (6), then regression on the first dimension.

    model : fitted, with time as the first dimension; times : shape (T,), in the unit of the model

    Raises ValueError for a model without time, and for times that are not finite.
    """

    def __init__(self, model: TPGMM, times: ArrayLike) -> None:
        self.times = _checked(model, times)
        self.manifold = _data_manifold(model.manifold_)
        self._adapter = Adapter(model)

    def retrieve(
        self,
        frames: Mapping[str, Frame],
        weights: Mapping[str, float] | None = None,
        state: ArrayLike | None = None,
    ) -> list[Gaussian]:
        """The movement, one Gaussian without time for each of the times.

        frames : over [time, data] (`Frame.with_time`), at least one of the model's
        weights : how far each frame is trusted, 0 to 1; fully where not named
        state : shape (D - 1,), where the robot is: what no frame constrains stays there; the origin where None

        Raises ValueError like `Adapter.adapt`, and for frames that change time.
        """
        without_time(frames)
        where = None if state is None else np.concatenate([[0.0], np.asarray(state, dtype=float)])
        means, covariances, _ = self._adapter.adapt_and_condition(frames, self.times, weights, where)
        manifold = _data_manifold(self._adapter.manifold)
        return [
            Gaussian(mean, 0.5 * (covariance + covariance.T), manifold)
            for mean, covariance in zip(means, covariances, strict=True)
        ]


class RegressThenProduct:
    """Regression on the first dimension in each frame, then the product of Eq. (6) at each time.

    Parameters and errors are those of `AdaptThenRegress`.
    """

    def __init__(self, model: TPGMM, times: ArrayLike) -> None:
        self.times = _checked(model, times)
        self.manifold = _data_manifold(model.manifold_)
        self._adapter = Adapter(_at_times(model, self.times))

    def retrieve(
        self,
        frames: Mapping[str, Frame],
        weights: Mapping[str, float] | None = None,
        state: ArrayLike | None = None,
    ) -> list[Gaussian]:
        """As `AdaptThenRegress.retrieve`."""
        product = self._adapter.adapt(without_time(frames), state, weights)
        return [product.component(i) for i in range(len(self.times))]


def _at_times(model: TPGMM, times: Array) -> TPGMM:
    """The movement as each frame expects it: a model over the data alone that has one component for each time."""
    result = TPGMM(len(times))
    result.priors_ = np.full(len(times), 1.0 / len(times))
    result.frame_names_ = model.frame_names_
    result.manifold_ = _data_manifold(model.manifold_)
    result.means_, result.covariances_ = {}, {}
    log_priors = np.log(np.maximum(model.priors_, np.finfo(float).tiny))
    for name, manifold in model.frame_manifolds_.items():
        n = manifold.tangent_dim - 1
        means, covariances = np.empty((len(times), manifold.dim - 1)), np.empty((len(times), n, n))
        kernels_regress.regress_all(
            log_priors,
            np.array(model.means_[name], order="C"),
            np.array(model.covariances_[name], order="C"),
            manifold.ambient_of_tangent,
            manifold.sphere_starts,
            times,
            means,
            covariances,
            np.empty((len(times), len(log_priors))),
        )
        result.means_[name] = means
        result.covariances_[name] = 0.5 * (covariances + np.swapaxes(covariances, 1, 2))
    return result


def _checked(model: TPGMM, times: ArrayLike) -> Array:
    for name, manifold in model.frame_manifolds_.items():
        if manifold.factors[0][0] != "R" or manifold.tangent_dim < 2:
            raise ValueError(f"regression needs time as the first dimension, then others; frame {name!r} is {manifold}")
    times = np.array(times, dtype=float)
    if times.ndim != 1 or len(times) == 0 or not np.all(np.isfinite(times)):
        raise ValueError(f"times have shape (T,) with T > 0 and are finite, got {times!r}")
    return times


def _data_manifold(manifold: Manifold) -> Manifold:
    return manifold.subset(range(1, manifold.dim))
