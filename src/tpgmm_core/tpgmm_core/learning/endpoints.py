# SPDX-License-Identifier: Apache-2.0
"""`EndpointTPGMM`: a TP-GMM that also knows where the demonstrations begin and end, as seen from each frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation import initialization
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.samples import Samples

BEGIN, END = 0, 1
"""Indices of the components of `EndpointTPGMM.endpoints_`."""


class EndpointTPGMM(TPGMM):
    """A mixture, and a Gaussian of the first and of the last samples of the demonstrations in each frame.

    Systems that are to end where the demonstrations ended take the goal from here. The mixture itself does not say
    where that is: each of its components describes a stretch of movement, and with many of them some stand for one
    demonstration alone. Parameters are those of `TPGMM`; `fit_projected` treats its samples as one demonstration.

    Attributes
    ----------
    endpoints_
        model of two components over the same data, where movements begin (BEGIN) and end (END), to be adapted to a
        situation like any other. Its covariances come from as few samples as there are demonstrations; half of the
        weight of one more sample for each dimension is added to their diagonal, so that a frame is not certain of what
        only a few demonstrations agree in. A frame that saw no end takes what it saw of the whole movement
    """

    endpoints_: TPGMM

    def _fit(self, samples: Samples, progress: EmProgress | None) -> EndpointTPGMM:
        super()._fit(samples, progress)
        self._learned_endpoints(*endpoint_gaussians(samples, self.reg_covar))
        return self

    def _learned_endpoints(self, means: Mapping[str, Array], covariances: Mapping[str, Array]) -> None:
        endpoints = TPGMM(2, reg_covar=self.reg_covar)
        endpoints.priors_ = np.full(2, 0.5)
        endpoints.frame_names_, endpoints.manifold_ = self.frame_names_, self.manifold_
        endpoints.means_, endpoints.covariances_ = dict(means), dict(covariances)
        self.endpoints_ = endpoints

    def _more_arrays(self) -> dict[str, Array]:
        arrays = {}
        for j, name in enumerate(self.frame_names_):
            arrays[f"ends_means_{j}"] = self.endpoints_.means_[name]
            arrays[f"ends_covariances_{j}"] = self.endpoints_.covariances_[name]
        return arrays

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        means, covariances = {}, {}
        for j, (name, manifold) in enumerate(self.frame_manifolds_.items()):
            mean, covariance = arrays[f"ends_means_{j}"], arrays[f"ends_covariances_{j}"]
            n = manifold.tangent_dim
            if mean.shape != (2, manifold.dim) or covariance.shape != (2, n, n):
                raise ValueError(
                    f"the ends of frame {shown(name)} have means (2, {manifold.dim}) and covariances (2, {n}, {n}), "
                    f"got {mean.shape} and {covariance.shape}"
                )
            if not np.all(np.linalg.eigvalsh(covariance) > 0.0):
                raise ValueError(f"the covariances of the ends in frame {shown(name)} are not positive definite")
            means[name], covariances[name] = mean, covariance
        self._learned_endpoints(means, covariances)


def endpoint_gaussians(samples: Samples, reg_covar: float) -> tuple[dict[str, Array], dict[str, Array]]:
    """Gaussians of the first and of the last samples of the demonstrations in each frame: see `EndpointTPGMM`.

    Parameters
    ----------
    samples
        of the demonstrations
    reg_covar
        added to the diagonals, in squared units of the data

    Returns
    -------
    tuple[dict[str, Array], dict[str, Array]]
        name -> means (2, D_j) and covariances (2, n_j, n_j), of BEGIN and END
    """
    last = np.cumsum(samples.lengths)
    labels = np.full(samples.n_samples, -1, dtype=np.intp)
    labels[last - np.asarray(samples.lengths)] = BEGIN
    labels[last - 1] = END
    means, covariances = {}, {}
    for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
        means[name], sampled = initialization.moments(samples.manifolds[name], x, seen, labels, 2, reg_covar)
        counts = np.array([np.count_nonzero(seen & (labels == k)) for k in (BEGIN, END)])
        covariances[name] = _towards_diagonal(sampled, counts)
    return means, covariances


def _towards_diagonal(covariances: Array, counts: Array) -> Array:
    """Covariances (K, n, n) of counts (K,) samples, with the weight of n / 2 more samples on their diagonals.

    The posterior mean under an inverse Wishart prior whose scale is the diagonal: definite, whatever the counts.
    """
    n = covariances.shape[-1]
    share = (0.5 * n / (0.5 * n + np.maximum(counts, 1)))[:, None, None]
    return np.asarray((1.0 - share) * covariances + share * covariances * np.eye(n))
