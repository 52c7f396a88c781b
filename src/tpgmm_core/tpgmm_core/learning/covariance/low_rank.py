# SPDX-License-Identifier: Apache-2.0
"""Sigma = Lambda Lambda^T + Psi with few columns in Lambda and a diagonal Psi, never inverted as a dense matrix.

With M = I + Lambda^T Psi^-1 Lambda, of the size of the few columns:
Sigma^-1 = Psi^-1 - Psi^-1 Lambda M^-1 Lambda^T Psi^-1 (Woodbury identity), and
log|Sigma| = log|M| + log|Psi| (matrix determinant lemma).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from tpgmm_core.common.constants import LOG_2PI
from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.classical import not_definite
from tpgmm_core.learning.covariance.structure import Covariances, Structure

MAX_ROUNDING = 1e-8
"""Error of a squared distance that is taken for the speed of products of matrices."""


@dataclass(frozen=True, eq=False)
class LowRankCovariances(Covariances):
    """Sigma_k = Lambda_k Lambda_k^T + diag(noise_k).

    Components that have fewer factors than others have columns of zeros.

    Parameters
    ----------
    structure
        settings of the structure
    loadings
        Lambda, shape (K, n, d)
    noise
        shape (K, n)
    """

    structure: Structure
    loadings: Array
    noise: Array
    arrays_of = ("loadings", "noise")

    def __post_init__(self) -> None:
        if not np.all(self.noise > 0.0):
            raise not_definite(int(np.argmin(self.noise.min(axis=1))))

    @classmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        """Read `loadings` (K, n, d) and `noise` (K, n): see `Covariances.from_arrays`.

        Raises
        ------
        ValueError
            for other shapes
        """
        loadings, noise = arrays["loadings"], arrays["noise"]
        if loadings.ndim != 3 or loadings.shape[:2] != noise.shape:
            raise ValueError(f"loadings have shape (K, n, d) and noise (K, n), got {loadings.shape} and {noise.shape}")
        return cls(structure, loadings, noise)

    @property
    def shape(self) -> tuple[int, int]:
        """K and n, of the noise."""
        K, n = self.noise.shape
        return K, n

    @cached_property
    def _inverse_roots(self) -> Array:
        """L^-1 of M = L L^T, (K, d, d)."""
        scaled = self.loadings / self.noise[:, :, None]
        M = np.eye(self.loadings.shape[2]) + np.swapaxes(scaled, 1, 2) @ self.loadings
        return np.linalg.inv(np.linalg.cholesky(M))

    @cached_property
    def projections(self) -> Array:
        """L^-1 Lambda^T Psi^-1, (K, d, n): with d Psi^-1 d^T, their squares make the squared distance."""
        return self._inverse_roots @ np.swapaxes(self.loadings / self.noise[:, :, None], 1, 2)

    @cached_property
    def regressions(self) -> Array:
        """B = Lambda^T Sigma^-1 = M^-1 Lambda^T Psi^-1, (K, d, n): the factors' expectation is B (x - mu)."""
        return np.swapaxes(self._inverse_roots, 1, 2) @ self.projections

    def regressions_of(self, T: Array) -> Array:
        """T^T Sigma^-1, (K, d, n), of other loadings T (K, n, d)."""
        Tt = np.swapaxes(T, 1, 2)
        return Tt / self.noise[:, None, :] - (Tt @ np.swapaxes(self.projections, 1, 2)) @ self.projections

    @property
    def top_loadings(self) -> Array:
        """Loadings (K, n, d) of the topmost factors, whose prior is N(0, I)."""
        return self.loadings

    @cached_property
    def posterior_covariances(self) -> Array:
        """Covariance M^-1 = I - B Lambda of the factors, given a sample, (K, d, d)."""
        return np.swapaxes(self._inverse_roots, 1, 2) @ self._inverse_roots

    @cached_property
    def log_determinants(self) -> Array:
        """log|Sigma_k| (K,), by the matrix determinant lemma."""
        log_M = -2.0 * np.log(np.diagonal(self._inverse_roots, axis1=1, axis2=2)).sum(axis=1)
        return np.asarray(log_M + np.log(self.noise).sum(axis=1))

    def squared_distances(self, k: int, d: Array) -> Array:
        """Squared Mahalanobis distances (N,) of d (N, n) to component k, by the Woodbury identity."""
        explained = d @ self.projections[k].T
        return np.asarray((d * d) @ (1.0 / self.noise[k]) - np.einsum("ni,ni->n", explained, explained))

    def log_densities(self, x: Array, means: Array) -> Array:
        """Log-densities (N, K) of all components by a few matrix products, where rounding allows to expand squares."""
        K, n = self.shape
        centre = means.mean(axis=0)
        x, means = x - centre, means - centre
        precisions = 1.0 / self.noise
        squares = (x * x) @ precisions.T
        if squares.max(initial=0.0) * np.finfo(float).eps > MAX_ROUNDING:
            return super().log_densities(x, means)
        squares -= 2.0 * x @ (means * precisions).T
        squares += (means * means * precisions).sum(axis=1)
        explained = x @ self.projections.reshape(-1, n).T - np.einsum("kdn,kn->kd", self.projections, means).ravel()
        explained *= explained
        squares -= explained.reshape(len(x), *self.loadings.shape[::2]).sum(axis=2)
        return -0.5 * (squares + (n * LOG_2PI + self.log_determinants))

    def dense(self) -> Array:
        """Lambda_k Lambda_k^T + diag(noise_k), (K, n, n)."""
        n = self.shape[1]
        return self.loadings @ np.swapaxes(self.loadings, 1, 2) + self.noise[:, :, None] * np.eye(n)

    def inverse_traces(self) -> Array:
        """tr(Sigma_k^-1), (K,), by the Woodbury identity."""
        return np.asarray((1.0 / self.noise).sum(axis=1) - (self.projections**2).sum(axis=(1, 2)))


def n_loadings(n: int, d: int) -> int:
    """Number of free parameters of a loadings matrix (n, d), which is determined up to a rotation of its columns."""
    return n * d - d * (d - 1) // 2


def principal(eigenvalues: Array, axes: Array, d: int, n_columns: int) -> tuple[Array, Array]:
    """Maximum likelihood solution of probabilistic PCA (Tipping and Bishop 1999, Eqs. 7 and 8).

    Parameters
    ----------
    eigenvalues
        shape (n,), ascending
    axes
        shape (n, n), their axes as columns
    d
        number of main axes, d < n
    n_columns
        of the loadings, from d on; columns beyond d are zero

    Returns
    -------
    tuple[Array, Array]
        loadings (n, n_columns) along the main axes, and noise (n,), the mean of the other eigenvalues
    """
    n = len(eigenvalues)
    noise = eigenvalues[: n - d].mean()
    loadings = np.zeros((n, n_columns))
    main = slice(n - 1, n - 1 - d, -1)
    loadings[:, :d] = axes[:, main] * np.sqrt(np.maximum(eigenvalues[main] - noise, 0.0))
    return loadings, np.full(n, noise)
