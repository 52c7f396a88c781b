# SPDX-License-Identifier: Apache-2.0
"""The end of a movement as a Gaussian of its own: a function of time that ends where the demonstrations ended.

The last component of a mixture over time is the mean of the last part of the movement, and regression at its end comes
only near where the demonstrations ended. Here each frame also keeps the Gaussian of the last samples that it saw, as
`EndpointTPGMM` does, and the product over the frames (Eq. 6) is the end in a situation, N(e, S). The movement bends to
it in its last part, as to a constraint (`exact.py`), but only as certainly as the demonstrations agree on it: with
k(s) = exp(-(1 - s)^2 / (2 WIDTH^2)) at the share s of the movement,

    mean(s) moves by k(s) log_mean(1)(e),   covariance(s) becomes (1 - k(s)^2) covariance(s) + k(s)^2 S.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.endpoints import END, endpoint_gaussians
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples
from tpgmm_core.retrieval.interface import TimeParametrized
from tpgmm_core.retrieval.wrapped import WrappedTimeParametrized

KEY = "own_end"
"""Key in metadata and settings."""
WIDTH = 0.1
"""Share of the movement over which it bends to the end, as a standard deviation."""


def keep_end(model: LearnedMixture, demonstrations: Sequence[Demonstration], space: Manifold) -> None:
    """Write into a model's metadata where the demonstrations ended, as each frame saw it.

    Parameters
    ----------
    model
        that was learned from the demonstrations
    demonstrations
        over [time, data]
    space
        of the demonstrations' data
    """
    means, covariances = endpoint_gaussians(Samples.from_demonstrations(demonstrations, space), model.reg_covar)
    model.metadata_[KEY] = 1.0
    for name in model.frame_names_:  # when they ended is known
        numbers = np.concatenate([means[name][END, 1:], covariances[name][END, 1:, 1:].ravel()])
        model.metadata_[f"{KEY}.{name}"] = " ".join(f"{number:.17g}" for number in numbers)


def end_of(model: LearnedMixture, data: Manifold) -> TPGMM | None:
    """The end as a mixture of one component over [time, data], to be adapted as any other; time says nothing in it.

    Parameters
    ----------
    model
        with metadata
    data
        the space of the movement, without time

    Returns
    -------
    TPGMM | None
        None for a model without it

    Raises
    ------
    ValueError
        for metadata that are no Gaussians of this space
    """
    if KEY not in model.metadata_:
        return None
    D, n = data.dim, data.tangent_dim
    end = TPGMM(1, reg_covar=model.reg_covar)
    end.priors_, end.manifold_, end.frame_names_ = np.ones(1), Manifold.parse(f"R1 x {data}"), model.frame_names_
    end.means_, end.covariances_ = {}, {}
    for name in model.frame_names_:
        text = model.metadata_.get(f"{KEY}.{name}")
        try:
            numbers = np.array([float(word) for word in str(text).split()])
        except ValueError:
            numbers = np.zeros(0)
        covariance = np.eye(n + 1)
        if numbers.shape == (D + n * n,) and np.all(np.isfinite(numbers)):
            covariance[1:, 1:] = numbers[D:].reshape(n, n)
        else:
            covariance[1:, 1:] = -1.0
        if not (np.allclose(covariance, covariance.T) and np.all(np.linalg.eigvalsh(covariance) > 0.0)):
            raise ValueError(
                f"{KEY}.{name} of a model is {D} numbers of a point and {n} x {n} of a covariance, got {shown(text)}: "
                "train it again"
            )
        end.means_[name] = np.concatenate([[0.0], numbers[:D]])[None]
        end.covariances_[name] = covariance[None]
    return end


class OwnEnd(WrappedTimeParametrized):
    """A movement as a function of time that ends where the demonstrations ended.

    Parameters
    ----------
    course
        the movement by itself; its situation is changed
    end
        of `end_of`
    width
        share of the movement over which it bends
    """

    def __init__(self, course: TimeParametrized, end: TPGMM, width: float = WIDTH) -> None:
        super().__init__(course)
        self._end, self._width = Adapter(end), width * course.duration
        self._shift: Array | None = None
        self._goal: tuple[Array, Array] | None = None

    def situate(
        self, frames: Mapping[str, Frame], state: Array | None = None, weights: Mapping[str, float] | None = None
    ) -> None:
        """Change to this situation: see `TimeParametrized.situate`."""
        super().situate(frames, state, weights)
        whole = None if state is None else np.concatenate([[0.0], state])
        mixture = self._end.adapt(frames, whole, weights)
        self._goal, self._shift = (mixture.means[0, 1:], mixture.covariances[0, 1:, 1:]), None

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """The movement at times (H,), s: see `TimeParametrized.at`."""
        times = np.asarray(times, dtype=float)
        if self._goal is None:
            return self._course.at(times)
        goal, certain = self._goal
        if self._shift is None:
            self._shift = self.manifold.log(self._course.at(np.array([self.duration]))[0][0], goal)
        means, covariances, activations = self._course.at(times)
        k = np.exp(-0.5 * ((self.duration - np.clip(times, 0.0, self.duration)) / self._width) ** 2)[:, None]
        share = (k**2)[:, :, None]
        return self.manifold.exp(means, k * self._shift), (1.0 - share) * covariances + share * certain, activations
