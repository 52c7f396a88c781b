# SPDX-License-Identifier: Apache-2.0
"""Semi-tied covariances: one basis for all components, and a diagonal for each (Gales 1999)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from tpgmm_core.common.constants import SINGULAR
from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.classical import inverse_factor, not_definite
from tpgmm_core.learning.covariance.structure import Covariances, Structure

SWEEPS = 3
"""Updates of all rows, and then of the diagonals, in each M-step of the mixture."""


@dataclass(frozen=True, eq=False)
class SemiTiedCovariances(Covariances):
    """Sigma_k = H diag(variances_k) H^T; the columns of H are synergies that all components share.

    The paper's "tied structures in the covariances to enable the organization and reuse of previously acquired
    synergies" (Section 4): with `fixed_bases`, H is that of another task, and only the variances are learned.

    Parameters
    ----------
    structure
        settings of the structure
    transform
        A = H^-1, shape (n, n), in whose coordinates every component is diagonal
    variances
        shape (K, n), in these coordinates
    """

    structure: Structure
    transform: Array
    variances: Array
    arrays_of = ("transform", "variances")

    def __post_init__(self) -> None:
        _check_variances(self.variances)

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """The axes that make two pooled scatters diagonal at once: exact for two components.

        With more components, the scatters are those of every second one and of all.

        Raises
        ------
        ValueError
            for a structure whose bases are fixed: see `start_given`
        """
        if structure.fixed_bases:
            raise ValueError("the bases of this structure are fixed, but none are given")
        halves = [counts[::2] @ scatters[::2].reshape(-1, scatters[0].size)]
        halves.append(counts @ scatters.reshape(-1, scatters[0].size))
        one, both = (half.reshape(scatters[0].shape) / counts.sum() for half in halves)
        _check_definite(both, scatters)
        A = scipy.linalg.eigh(one, both)[1].T
        return cls(structure, A, _diagonals(A, scatters))

    @classmethod
    def start_given(cls, structure: Structure, given: Array, scatters: Array) -> Self:
        """With the transform A: the likeliest variances are diag(A S_k A^T) (Gales 1999, Section III)."""
        return cls(structure, given, _diagonals(given, scatters))

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """Raise the likelihood by SWEEPS updates of all rows of A, each followed by the diagonals.

        With `fixed_bases`, the diagonals alone, which are then the maximum.
        """
        if self.structure.fixed_bases:
            return self.start_given(self.structure, self.transform, scatters)
        A, variances = self.transform, self.variances
        _check_definite(np.einsum("k,kij->ij", counts, scatters), scatters)
        for _ in range(SWEEPS):
            A = _rows_updated(A, variances, counts, scatters)
            variances = _diagonals(A, scatters)
            _check_variances(variances)
        return type(self)(self.structure, A, variances)

    @classmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        """Read `transform` (n, n) and `variances` (K, n): see `Covariances.from_arrays`.

        Raises
        ------
        ValueError
            for other shapes, and a transform that is not regular
        """
        A, variances = arrays["transform"], arrays["variances"]
        if variances.ndim != 2 or A.shape != (variances.shape[1],) * 2 or np.linalg.matrix_rank(A) < len(A):
            raise ValueError(
                f"the transform is a regular matrix (n, n) and variances have shape (K, n), got {A.shape} and "
                f"{variances.shape}"
            )
        return cls(structure, A, variances)

    @property
    def shape(self) -> tuple[int, int]:
        """K and n, of the variances."""
        K, n = self.variances.shape
        return K, n

    @cached_property
    def basis(self) -> Array:
        """H = A^-1, (n, n)."""
        return np.linalg.inv(self.transform)

    @cached_property
    def log_determinants(self) -> Array:
        """log|Sigma_k| (K,), from the variances and the determinant of A."""
        return np.asarray(np.log(self.variances).sum(axis=1) - 2.0 * np.linalg.slogdet(self.transform)[1])

    def squared_distances(self, k: int, d: Array) -> Array:
        """Squared Mahalanobis distances (N,) of d (N, n) to component k, in the coordinates A d."""
        y = d @ self.transform.T
        return np.asarray((y * y) @ (1.0 / self.variances[k]))

    def dense(self) -> Array:
        """H diag(variances_k) H^T, (K, n, n)."""
        return (self.basis * self.variances[:, None, :]) @ self.basis.T

    def inverse_traces(self) -> Array:
        """tr(Sigma_k^-1), (K,): the squared norms of the rows of A over the variances."""
        return np.asarray((1.0 / self.variances) @ (self.transform**2).sum(axis=1))

    @property
    def n_parameters(self) -> int:
        """Free parameters: n (n - 1) + K n, since the scale of the rows of A is free.

        For one or two components they are those of full covariances. With `fixed_bases`, K n.
        """
        K, n = self.shape
        if self.structure.fixed_bases:
            return K * n
        return min(n * (n - 1) + K * n, K * n * (n + 1) // 2)


def _check_variances(variances: Array) -> None:
    """Raise ValueError for a component whose variance along some axis is zero but for rounding."""
    if not np.all(variances > SINGULAR * variances.max(axis=0)):
        raise not_definite(int(np.argmin(variances.min(axis=1))))


def _check_definite(pooled: Array, scatters: Array) -> None:
    """Raise ValueError where all components together lie in a subspace; one alone may."""
    inverse_factor(pooled, int(np.argmin(np.linalg.eigvalsh(scatters)[:, 0])))


def _diagonals(A: Array, scatters: Array) -> Array:
    """diag(A S_k A^T), (K, n)."""
    return np.einsum("kij,ij->ki", A @ scatters, A)


def _rows_updated(A: Array, variances: Array, counts: Array, scatters: Array) -> Array:
    """Each row of A in turn where the likelihood is largest, the others fixed (Gales 1999, Eq. 22).

    a_i = c G_i^-1 sqrt(sum_k counts_k / (c G_i^-1 c^T)), G_i = sum_k counts_k / variances_ki S_k, c the cofactors of
    row i. Column i of A^-1 is c / |A|, and the scale of c cancels.
    """
    A, H = A.copy(), np.linalg.inv(A)
    total = counts.sum()
    flat = scatters.reshape(len(scatters), -1)
    for i in range(len(A)):
        G = ((counts / variances[:, i]) @ flat).reshape(A.shape)
        row = np.linalg.solve(G, H[:, i])
        row *= np.sqrt(total / (H[:, i] @ row))
        change = row - A[i]
        H -= np.outer(H[:, i], change @ H) / (1.0 + change @ H[:, i])  # Sherman-Morrison
        A[i] = row
    return A
