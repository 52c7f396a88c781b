# SPDX-License-Identifier: Apache-2.0
"""`Emissions`: K Gaussians seen from P frames, with one covariance structure; E-step densities and M-step (Section 3).

Mixtures and (semi-)Markov models differ in where the responsibilities come from, and share this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.covariance.structure import Covariances, Structure
from tpgmm_core.learning.covariance.structures import covariances_class
from tpgmm_core.learning.estimation import initialization
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.initialization import Labels
from tpgmm_core.learning.estimation.kernels_em import EMPTY
from tpgmm_core.learning.estimation.kernels_expectation import NEGLIGIBLE
from tpgmm_core.model.samples import Samples

CHUNK_NUMBERS = 1 << 18
"""Numbers in the largest temporary array: samples are worked on in chunks, so that memory stays bounded."""


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Weighted moments of the samples of one frame: all that an M-step needs of them.

    Where a count is 0, means and scatters have no meaning.

    Parameters
    ----------
    counts
        shape (K,), summed weights
    means
        shape (K, D_j)
    scatters
        shape (K, n_j, n_j), covariances of the tangent vectors at these means
    """

    counts: Array
    means: Array
    scatters: Array


@dataclass(frozen=True, eq=False)
class Emissions:
    """K components seen from P frames, the same structure for all; immutable.

    Parameters
    ----------
    structure
        kind of covariances, with regularisation
    manifolds
        name → space of the frame's view
    means
        name → shape (K, D_j), ambient
    frames
        name → the K covariances of that frame
    prior_scatter
        Psi of the prior exp(-1/2 tr(Psi Sigma^-1)) is prior_scatter I; 0 with "add"
    prior
        of the covariances, besides the regularisation
    """

    structure: Structure
    manifolds: Mapping[str, Manifold]
    means: Mapping[str, Array]
    frames: Mapping[str, Covariances]
    prior_scatter: float = 0.0
    prior: CovariancePrior | None = None

    @classmethod
    def from_labels(
        cls, structure: Structure, samples: Samples, labels: Labels, reg_covar: float | None = None
    ) -> Emissions:
        """Components of labelled samples.

        A component of which a frame saw nothing starts from all that the frame saw.

        Parameters
        ----------
        structure
            of the covariances
        samples
            what all frames saw
        labels
            shape (N,), 0 to K - 1, or -1 for a sample that is left out; K is the largest label + 1
        reg_covar
            added to the diagonals of the unbiased covariances; None: that of the structure

        Returns
        -------
        Emissions
            one component per label
        """
        K = int(labels.max()) + 1
        reg_covar = structure.reg_covar if reg_covar is None else reg_covar
        counts = np.bincount(labels[labels >= 0], minlength=K).astype(float)
        means, scatters = {}, {}
        for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
            means[name], scatters[name] = initialization.moments(samples.manifolds[name], x, seen, labels, K, reg_covar)
        return cls.from_gaussians(structure, samples, counts, means, scatters)

    @classmethod
    def from_gaussians(
        cls,
        structure: Structure,
        samples: Samples,
        counts: Array,
        means: Mapping[str, Array],
        covariances: Mapping[str, Array],
        given: Mapping[str, Array] | None = None,
    ) -> Emissions:
        """Components of a structure that are nearest to Gaussians with full covariances.

        Parameters
        ----------
        structure
            of the covariances
        samples
            what all frames saw
        counts
            shape (K,), number of samples of each component
        means
            name → shape (K, D_j)
        covariances
            name → shape (K, n_j, n_j)
        given
            name → the part of the structure that is given (`Covariances.start_given`)

        Returns
        -------
        Emissions
            with the same means
        """
        kind = covariances_class(structure)
        if given is None:
            frames = {name: _named(name, kind.start, structure, counts, covariances[name]) for name in samples.X}
        else:
            frames = {
                name: _named(name, kind.start_given, structure, given[name], covariances[name]) for name in samples.X
            }
        K, is_prior = len(counts), structure.regularization == "prior"
        prior_scatter = structure.reg_covar * samples.n_samples / K if is_prior else 0.0
        return cls(structure, dict(samples.manifolds), dict(means), frames, prior_scatter)

    @property
    def n_components(self) -> int:
        """K, from the means."""
        return len(next(iter(self.means.values())))

    @property
    def covariances(self) -> dict[str, Array]:
        """Name → dense covariances (K, n_j, n_j), made on request."""
        return {name: frame.dense() for name, frame in self.frames.items()}

    @property
    def n_parameters(self) -> int:
        """Free parameters of means and covariances, without the priors."""
        return sum(frame.n_parameters + frame.n_mean_parameters for frame in self.frames.values())

    def log_density(self, samples: Samples) -> Array:
        """Log-density log prod_j N(x_n^(j); mu_k^(j), Sigma_k^(j)), (N, K), over the frames j that saw the sample."""
        out = np.zeros((samples.n_samples, self.n_components))
        for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
            manifold, frame = self.manifolds[name], self.frames[name]
            means = self.means[name]
            for part in chunks(len(x), manifold.dim):
                if manifold.is_euclidean:
                    out[part] += seen[part, None] * frame.log_densities(x[part], means)
                else:
                    for k, mean in enumerate(means):
                        out[part, k] += seen[part] * frame.log_density(k, manifold.log(mean, x[part]))
        return out

    def moments(self, samples: Samples, responsibilities: Array) -> dict[str, Moments]:
        """Name → moments of the samples, weighted by responsibilities (N, K), about the new means."""
        return {
            name: frame_moments(self.manifolds[name], x, _seen_weights(responsibilities, seen), self.means[name])
            for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True)
        }

    def updated(self, moments: Mapping[str, Moments]) -> Emissions:
        """M-step from moments; components without samples, in all or in one frame, keep their Gaussian.

        The regularisation is the same for every structure: reg_covar I ("add") or prior_scatter / count I
        ("prior") is added to every scatter; the M-step then fits the structure to the sum.

        Parameters
        ----------
        moments
            of each frame, by name

        Returns
        -------
        Emissions
            the components after the step
        """
        means, frames = {}, {}
        for name, moment in moments.items():
            manifold, frame = self.manifolds[name], self.frames[name]
            alive = moment.counts > EMPTY
            counts, scatters = np.maximum(moment.counts, EMPTY), moment.scatters
            if self.prior is not None:
                counts, scatters = self.prior.with_samples(name, counts, scatters)
            ridge = self.prior_scatter / np.where(alive, counts, 1.0)
            ridge += self.structure.reg_covar if self.structure.regularization == "add" else 0.0
            scatters = scatters + ridge[:, None, None] * np.eye(manifold.tangent_dim)
            if not alive.all():
                scatters = np.where(alive[:, None, None], scatters, frame.dense())
            steps = frame.mean_steps(manifold.log(self.means[name], moment.means))
            means[name] = np.where(alive[:, None], manifold.exp(self.means[name], steps), self.means[name])
            frames[name] = _named(name, frame.maximised, counts, scatters)
        return replace(self, means=means, frames=frames)

    def maximised(self, samples: Samples, responsibilities: Array) -> Emissions:
        """M-step for responsibilities.

        Parameters
        ----------
        samples
            what all frames saw
        responsibilities
            shape (N, K)

        Returns
        -------
        Emissions
            the components after the step

        Raises
        ------
        ValueError
            when a covariance is no longer positive definite
        """
        return self.updated(self.moments(samples, responsibilities))

    def penalty(self) -> float:
        """What the regularisation subtracts from the log-likelihood of all samples.

        "add": 0, and the log-likelihood may fall in its last digits. "prior": -log of the prior exp(-1/2 tr(Psi
        Sigma^-1)), Psi = reg_covar N / K I, summed over all covariances, without its constant: the log-likelihood
        less this never falls on Euclidean data. `CovariancePrior.penalty` comes on top.

        Returns
        -------
        float
            nats
        """
        own = 0.0 if self.prior is None else self.prior.penalty(self.frames)
        if self.prior_scatter == 0.0:
            return own
        return own + 0.5 * self.prior_scatter * float(sum(f.inverse_traces().sum() for f in self.frames.values()))


def frame_moments(manifold: Manifold, x: Array, weights: Array, base: Array) -> Moments:
    """Weighted moments, in bounded memory.

    On S³ the mean is one step along the mean tangent vector at the base.

    Parameters
    ----------
    manifold
        space of the samples
    x
        shape (N, D_j)
    weights
        shape (N, K)
    base
        shape (K, D_j), near the means

    Returns
    -------
    Moments
        counts, means and scatters
    """
    counts = weights.sum(axis=0)
    share = np.where(counts > EMPTY, counts, 1.0)[:, None]
    first, second = _sums(manifold, x, weights, base)
    means = manifold.exp(base, first / share)
    if manifold.is_euclidean:
        scatters = second / share[:, :, None] - np.einsum("ki,kj->kij", first / share, first / share)
    else:  # a shift of the tangent space is not just a subtraction
        scatters = _sums(manifold, x, weights, means)[1] / share[:, :, None]
    return Moments(counts, means, scatters)


def _sums(manifold: Manifold, x: Array, weights: Array, base: Array) -> tuple[Array, Array]:
    """Weighted sums of d and of d d^T, (K, n) and (K, n, n), of the tangent vectors d from the base to x."""
    K, n = len(base), manifold.tangent_dim
    first, second = np.zeros((K, n)), np.zeros((K, n, n))
    for part in chunks(len(x), manifold.dim):
        for k in range(K):
            w = weights[part, k]
            rows: NDArray[np.intp] = np.flatnonzero(w > NEGLIGIBLE)
            if len(rows) == 0:
                continue
            d = manifold.log(base[k], x[part][rows])
            first[k] += w[rows] @ d
            d *= np.sqrt(w[rows])[:, None]
            second[k] += d.T @ d
    return first, second


def _seen_weights(responsibilities: Array, seen: NDArray[np.bool_]) -> Array:
    """Weights (N, K), zero where the frame saw nothing."""
    return responsibilities if seen.all() else responsibilities * seen[:, None]


def chunks(n_samples: int, dim: int) -> Iterator[slice]:
    """Slices of the samples, each of at most CHUNK_NUMBERS numbers."""
    size = max(CHUNK_NUMBERS // dim, 1)
    return (slice(start, min(start + size, n_samples)) for start in range(0, n_samples, size))


def _named(name: str, make: Callable[..., Covariances], *arguments: Any) -> Covariances:
    """Call make(*arguments); its errors then say which frame they are about."""
    try:
        return make(*arguments)
    except ValueError as error:
        raise ValueError(f"frame {name!r}: {error}") from None
