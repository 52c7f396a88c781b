# SPDX-License-Identifier: Apache-2.0
"""Full, diagonal, spherical and tied covariances (e.g. McLachlan and Peel, Finite Mixture Models, 2000)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from tpgmm_core.common.constants import SINGULAR
from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.structure import Covariances, Structure


def not_definite(k: int) -> ValueError:
    """Make the error for component k, whose covariance is not positive definite."""
    return ValueError(
        f"the covariance of component {k} is not positive definite: its samples lie in a subspace; "
        "give a larger reg_covar, or take fewer components"
    )


def inverse_factor(S: Array, k: int) -> Array:
    """L^-1 (n, n) of the covariance S = L L^T of a component.

    Parameters
    ----------
    S
        shape (n, n)
    k
        the component, for the error

    Returns
    -------
    Array
        L^-1, shape (n, n)

    Raises
    ------
    ValueError
        when S is not definite, or is so by rounding alone
    """
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        raise not_definite(k) from None
    if np.any(np.diagonal(L) ** 2 <= SINGULAR * np.diagonal(S)):
        raise not_definite(k)
    return np.tril(np.linalg.inv(L))  # LAPACK's triangular solve starts threads even for the smallest matrices


@dataclass(frozen=True, eq=False)
class FullCovariances(Covariances):
    """Covariances Sigma_k without any structure.

    Parameters
    ----------
    structure
        settings of the structure
    covariances
        shape (K, n, n), positive definite
    """

    structure: Structure
    covariances: Array
    arrays_of = ("covariances",)

    def __post_init__(self) -> None:
        _ = self._factors  # raises where a covariance is not definite

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """The scatters themselves."""
        return cls(structure, scatters)

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """M-step: Sigma_k = S_k."""
        return type(self)(self.structure, scatters)

    @classmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        """Read `covariances` (K, n, n): see `Covariances.from_arrays`.

        Raises
        ------
        ValueError
            for another shape
        """
        covariances = arrays["covariances"]
        if covariances.ndim != 3 or covariances.shape[1] != covariances.shape[2]:
            raise ValueError(f"covariances have shape (K, n, n), got {covariances.shape}")
        return cls(structure, covariances)

    @property
    def shape(self) -> tuple[int, int]:
        """K and n, of the covariances."""
        K, n, _ = self.covariances.shape
        return K, n

    @cached_property
    def _factors(self) -> Array:
        return np.stack([inverse_factor(S, k) for k, S in enumerate(self.covariances)])

    @cached_property
    def log_determinants(self) -> Array:
        """log|Sigma_k| (K,), from the Cholesky factors."""
        return np.asarray(-2.0 * np.log(np.diagonal(self._factors, axis1=1, axis2=2)).sum(axis=1))

    def squared_distances(self, k: int, d: Array) -> Array:
        """Squared Mahalanobis distances (N,) of d (N, n) to component k, by its inverse Cholesky factor."""
        whitened = d @ self._factors[k].T
        return np.einsum("ni,ni->n", whitened, whitened)

    def dense(self) -> Array:
        """The covariances as they are kept, (K, n, n)."""
        return self.covariances

    def inverse_traces(self) -> Array:
        """tr(Sigma_k^-1), (K,): the squared norms of the inverse Cholesky factors."""
        return np.einsum("kij,kij->k", self._factors, self._factors)

    @property
    def n_parameters(self) -> int:
        """Free parameters: K n (n + 1) / 2."""
        K, n = self.shape
        return K * n * (n + 1) // 2


@dataclass(frozen=True, eq=False)
class TiedCovariances(FullCovariances):
    """One Sigma for all components of a frame, repeated: covariances has shape (K, n, n)."""

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """The mean of the scatters, weighted by the counts, for all components."""
        return cls(structure, _pooled(counts, scatters))

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """M-step: Sigma = sum_k counts_k S_k / sum_k counts_k."""
        return type(self)(self.structure, _pooled(counts, scatters))

    @property
    def n_parameters(self) -> int:
        """Free parameters: n (n + 1) / 2, whatever K is."""
        n = self.shape[1]
        return n * (n + 1) // 2


def _pooled(counts: Array, scatters: Array) -> Array:
    pooled = np.einsum("k,kij->ij", counts / counts.sum(), scatters)
    return np.repeat(pooled[None], len(counts), axis=0)


@dataclass(frozen=True, eq=False)
class DiagonalCovariances(Covariances):
    """Diagonal covariances, Sigma_k = diag(variances_k).

    Parameters
    ----------
    structure
        settings of the structure
    variances
        shape (K, n), positive
    """

    structure: Structure
    variances: Array
    arrays_of = ("variances",)

    def __post_init__(self) -> None:
        if not np.all(self.variances > 0.0):
            raise not_definite(int(np.argmin(self.variances.min(axis=1))))

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """The diagonals of the scatters."""
        return cls(structure, cls._variances(scatters))

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """M-step: variances_k = diag(S_k)."""
        return type(self)(self.structure, self._variances(scatters))

    @classmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        """Read `variances` (K, n): see `Covariances.from_arrays`.

        Raises
        ------
        ValueError
            for another shape
        """
        variances = arrays["variances"]
        if variances.ndim != 2:
            raise ValueError(f"variances have shape (K, n), got {variances.shape}")
        return cls(structure, variances)

    @staticmethod
    def _variances(scatters: Array) -> Array:
        return np.diagonal(scatters, axis1=1, axis2=2).copy()

    @property
    def shape(self) -> tuple[int, int]:
        """K and n, of the variances."""
        K, n = self.variances.shape
        return K, n

    @cached_property
    def log_determinants(self) -> Array:
        """log|Sigma_k| (K,): the sums of the logarithms of the variances."""
        return np.asarray(np.log(self.variances).sum(axis=1))

    def squared_distances(self, k: int, d: Array) -> Array:
        """Sum over the dimensions of d_i^2 / variance_i, (N,), for d (N, n)."""
        return np.asarray((d * d) @ (1.0 / self.variances[k]))

    def dense(self) -> Array:
        """Diagonal matrices (K, n, n)."""
        return self.variances[:, :, None] * np.eye(self.shape[1])

    def inverse_traces(self) -> Array:
        """Sums (K,) of the inverse variances."""
        return np.asarray((1.0 / self.variances).sum(axis=1))

    @property
    def n_parameters(self) -> int:
        """Free parameters: K n."""
        return int(self.variances.size)


@dataclass(frozen=True, eq=False)
class SphericalCovariances(DiagonalCovariances):
    """Spherical covariances, Sigma_k = sigma_k^2 I: `variances` (K, n) is constant along each row."""

    @staticmethod
    def _variances(scatters: Array) -> Array:
        mean = np.einsum("kii->k", scatters) / scatters.shape[1]
        return np.repeat(mean[:, None], scatters.shape[1], axis=1)

    @property
    def n_parameters(self) -> int:
        """Free parameters: K, one variance each."""
        return self.shape[0]
