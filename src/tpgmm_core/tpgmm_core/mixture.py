# SPDX-License-Identifier: Apache-2.0
"""`GaussianMixture`: what a TP-GMM becomes in one situation, and regression on it (GMR)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold
from tpgmm_core.quaternion import Array


@dataclass(frozen=True, slots=True, eq=False)
class GaussianMixture:
    """Mixture of K Gaussians.

    Parameters
    ----------
    priors : shape (K,), positive, summing to 1
    means : shape (K, D), ambient coordinates
    covariances : shape (K, D_tangent, D_tangent), each in the tangent space at its mean
    manifold : the space; None means R^D

    Raises ValueError for shapes that do not fit.
    """

    priors: Array
    means: Array
    covariances: Array
    manifold: Manifold

    def __init__(
        self, priors: ArrayLike, means: ArrayLike, covariances: ArrayLike, manifold: Manifold | None = None
    ) -> None:
        priors, means = np.asarray(priors, dtype=float), np.asarray(means, dtype=float)
        covariances = np.asarray(covariances, dtype=float)
        if means.ndim != 2:
            raise ValueError(f"the means of a mixture have shape (K, D), got {means.shape}")
        manifold = Manifold.euclidean(means.shape[1]) if manifold is None else manifold
        K, n = len(means), manifold.tangent_dim
        if priors.shape != (K,) or means.shape != (K, manifold.dim) or covariances.shape != (K, n, n):
            raise ValueError(
                f"a mixture on {manifold} has priors ({K},), means ({K}, {manifold.dim}) and covariances "
                f"({K}, {n}, {n}), got {priors.shape}, {means.shape} and {covariances.shape}"
            )
        object.__setattr__(self, "priors", priors)
        object.__setattr__(self, "means", means)
        object.__setattr__(self, "covariances", covariances)
        object.__setattr__(self, "manifold", manifold)

    def component(self, k: int) -> Gaussian:
        """The k-th Gaussian, without its prior."""
        return Gaussian(self.means[k], self.covariances[k], self.manifold)

    def responsibilities(self, dims: Sequence[int], values: ArrayLike) -> Array:
        """How much each component accounts for `values` (..., len(dims)) of the dimensions `dims`: (K, ...).

        Computed in logarithms; sums to 1 over the components also far from all of them.
        """
        log_joint = self._log_joint(dims, values)
        joint = np.exp(log_joint - log_joint.max(axis=0))
        return joint / joint.sum(axis=0)

    def log_density(self, x: ArrayLike) -> Array:
        """Logarithm of the density (...,) at points x (..., D)."""
        log_joint = self._log_joint(range(self.manifold.dim), x)
        top = log_joint.max(axis=0)
        return np.asarray(top + np.log(np.exp(log_joint - top).sum(axis=0)))

    def _log_joint(self, dims: Sequence[int], values: ArrayLike) -> Array:
        densities = [self.component(k).marginal(dims).log_density(values) for k in range(len(self.priors))]
        log_priors = np.log(np.maximum(self.priors, np.finfo(float).tiny))
        return np.stack([p + d for p, d in zip(log_priors, densities, strict=True)])

    def condition(self, dims: Sequence[int], values: ArrayLike) -> Gaussian:
        """Gaussian mixture regression: the other dimensions, given `values` (len(dims),) of the dimensions
        `dims`.

        The Gaussian has the first two moments of the conditional mixture. On S³ its mean is where the
        weighted tangent vectors to the components' means cancel out, and their covariances are moved there
        by parallel transport. A loop over time uses `Adapter.adapt_and_condition`, which is compiled.
        """
        h = self.responsibilities(dims, values)
        parts = [self.component(k).condition(dims, values) for k in range(len(h))]
        manifold = parts[0].manifold
        means = np.stack([part.mean for part in parts])
        mean = manifold.mean(means, h)
        T = manifold.transport(means, mean)
        within = T @ np.stack([part.covariance for part in parts]) @ np.swapaxes(T, 1, 2)
        d = manifold.log(mean, means)
        covariance = np.einsum("k,kij->ij", h, within) + (h[:, None] * d).T @ d
        return Gaussian(mean, 0.5 * (covariance + covariance.T), manifold)
