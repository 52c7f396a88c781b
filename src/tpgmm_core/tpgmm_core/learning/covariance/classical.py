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
    """What to raise when the covariance of component k is not positive definite."""
    return ValueError(
        f"the covariance of component {k} is not positive definite: its samples lie in a subspace; "
        "give a larger reg_covar, or take fewer components"
    )


def inverse_factor(S: Array, k: int) -> Array:
    """L^-1 (n, n) of S = L L^T (n, n), the covariance of component k.

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
    """Sigma_k as it comes; covariances : shape (K, n, n)."""

    structure: Structure
    covariances: Array
    arrays_of = ("covariances",)

    def __post_init__(self) -> None:
        _ = self._factors  # raises where a covariance is not definite

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        return cls(structure, scatters)

    def maximised(self, counts: Array, scatters: Array) -> Self:
        return type(self)(self.structure, scatters)

    @classmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        covariances = arrays["covariances"]
        if covariances.ndim != 3 or covariances.shape[1] != covariances.shape[2]:
            raise ValueError(f"covariances have shape (K, n, n), got {covariances.shape}")
        return cls(structure, covariances)

    @property
    def shape(self) -> tuple[int, int]:
        K, n, _ = self.covariances.shape
        return K, n

    @cached_property
    def _factors(self) -> Array:
        return np.stack([inverse_factor(S, k) for k, S in enumerate(self.covariances)])

    @cached_property
    def log_determinants(self) -> Array:
        return np.asarray(-2.0 * np.log(np.diagonal(self._factors, axis1=1, axis2=2)).sum(axis=1))

    def squared_distances(self, k: int, d: Array) -> Array:
        whitened = d @ self._factors[k].T
        return np.einsum("ni,ni->n", whitened, whitened)

    def dense(self) -> Array:
        return self.covariances

    def inverse_traces(self) -> Array:
        return np.einsum("kij,kij->k", self._factors, self._factors)

    @property
    def n_parameters(self) -> int:
        K, n = self.shape
        return K * n * (n + 1) // 2


@dataclass(frozen=True, eq=False)
class TiedCovariances(FullCovariances):
    """One Sigma for all components of a frame, repeated: covariances has shape (K, n, n)."""

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        return cls(structure, _pooled(counts, scatters))

    def maximised(self, counts: Array, scatters: Array) -> Self:
        return type(self)(self.structure, _pooled(counts, scatters))

    @property
    def n_parameters(self) -> int:
        n = self.shape[1]
        return n * (n + 1) // 2


def _pooled(counts: Array, scatters: Array) -> Array:
    pooled = np.einsum("k,kij->ij", counts / counts.sum(), scatters)
    return np.repeat(pooled[None], len(counts), axis=0)


@dataclass(frozen=True, eq=False)
class DiagonalCovariances(Covariances):
    """Sigma_k = diag(variances_k); variances : shape (K, n)."""

    structure: Structure
    variances: Array
    arrays_of = ("variances",)

    def __post_init__(self) -> None:
        if not np.all(self.variances > 0.0):
            raise not_definite(int(np.argmin(self.variances.min(axis=1))))

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        return cls(structure, cls._variances(scatters))

    def maximised(self, counts: Array, scatters: Array) -> Self:
        return type(self)(self.structure, self._variances(scatters))

    @classmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        variances = arrays["variances"]
        if variances.ndim != 2:
            raise ValueError(f"variances have shape (K, n), got {variances.shape}")
        return cls(structure, variances)

    @staticmethod
    def _variances(scatters: Array) -> Array:
        return np.diagonal(scatters, axis1=1, axis2=2).copy()

    @property
    def shape(self) -> tuple[int, int]:
        K, n = self.variances.shape
        return K, n

    @cached_property
    def log_determinants(self) -> Array:
        return np.asarray(np.log(self.variances).sum(axis=1))

    def squared_distances(self, k: int, d: Array) -> Array:
        return np.asarray((d * d) @ (1.0 / self.variances[k]))

    def dense(self) -> Array:
        return self.variances[:, :, None] * np.eye(self.shape[1])

    def inverse_traces(self) -> Array:
        return np.asarray((1.0 / self.variances).sum(axis=1))

    @property
    def n_parameters(self) -> int:
        return int(self.variances.size)


@dataclass(frozen=True, eq=False)
class SphericalCovariances(DiagonalCovariances):
    """Sigma_k = sigma_k^2 I, as variances (K, n) that are equal in every row."""

    @staticmethod
    def _variances(scatters: Array) -> Array:
        mean = np.einsum("kii->k", scatters) / scatters.shape[1]
        return np.repeat(mean[:, None], scatters.shape[1], axis=1)

    @property
    def n_parameters(self) -> int:
        return self.shape[0]
