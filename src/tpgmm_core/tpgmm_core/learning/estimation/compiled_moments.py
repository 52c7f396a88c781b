# SPDX-License-Identifier: Apache-2.0
"""E-step and moments of a mixture in one compiled pass over the samples, where dimensions are few.

Dense covariances of few dimensions cost less than what numpy adds to every call; no array of the size of the samples
is made. Where dimensions are many, `Emissions` with their structure's own algebra is faster.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation import kernels_em
from tpgmm_core.learning.estimation.compiled_em import MixtureParameters, Workspace
from tpgmm_core.learning.estimation.emissions import Emissions, Moments
from tpgmm_core.learning.estimation.kernels_em import EMPTY
from tpgmm_core.model.samples import Samples

MAX_DIM = 20
"""Most tangent dimensions of a frame for which this is used."""


class CompiledMoments:
    """The samples in the arrangement of `kernels_em`, for the moments of any number of mixtures."""

    def __init__(self, samples: Samples, priors: Array, emissions: Emissions) -> None:
        self._workspace = Workspace(samples, MixtureParameters(priors, emissions.means, emissions.covariances))

    @staticmethod
    def suits(emissions: Emissions) -> bool:
        """Whether the frames are small enough."""
        return max(manifold.tangent_dim for manifold in emissions.manifolds.values()) <= MAX_DIM

    def __call__(self, priors: Array, emissions: Emissions) -> tuple[float, Array, dict[str, Moments]]:
        """Log-likelihood of all samples together, weight (K,) of each component, and name → moments.

        Raises ValueError when a covariance is not positive definite.
        """
        w = self._workspace
        w.log_priors[:] = np.log(np.maximum(priors, np.finfo(float).tiny))
        for j, name in enumerate(w.names):
            row, n = w.layout[j]
            w.means[:, row : row + w.manifolds[j].dim] = emissions.means[name]
            w.covariances[j, :, :n, :n] = emissions.frames[name].dense()
        w.factorise()
        log_likelihood = w.expectation()
        if len(w.spheres):
            w.recentre()
        else:
            kernels_em.move_means(w.layout, w.flat, w.spheres, w.means, w.counts, w.first)
        return log_likelihood, w.counts[-1].copy(), {name: self._moments(j) for j, name in enumerate(w.names)}

    def _moments(self, j: int) -> Moments:
        """Moments of frame j, about its new means."""
        w = self._workspace
        row, n = w.layout[j]
        counts = w.counts[j].copy()
        share = np.where(counts > EMPTY, counts, 1.0)
        lower = w.second[j, :, :n, :n] / share[:, None, None]
        scatters = np.tril(lower) + np.swapaxes(np.tril(lower, -1), 1, 2)
        first = w.first[j, :, :n] / share[:, None]
        scatters -= first[:, :, None] * first[:, None, :]
        return Moments(counts, w.means[:, row : row + w.manifolds[j].dim].copy(), scatters)
