# SPDX-License-Identifier: Apache-2.0
"""Factor analyzers, probabilistic principal component analyzers, and the parsimonious model with its own dimensions.

Section 4 of the paper: Sigma_k = Lambda_k Lambda_k^T + Psi_k spans what lies between diagonal and full covariances.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.low_rank import LowRankCovariances, n_loadings, principal
from tpgmm_core.learning.covariance.structure import Structure

INNER_STEPS = 5
START_STEPS = 50
"""Steps of EM on the factors in each M-step of the mixture, and before the first: they cost little beside the
scatters, and factors converge slowly."""


@dataclass(frozen=True, eq=False)
class FactorAnalyzers(LowRankCovariances):
    """Mixture of factor analyzers, diagonal Psi_k (Ghahramani and Hinton 1996; McLachlan, Peel and Bean 2003).

    The means are updated with the factors integrated out, then the factors with the means fixed: an alternating
    expectation conditional maximisation as in McLachlan et al., whose likelihood never falls. The noise stays
    above a share 1 / K of reg_covar, so that no dimension is explained away (a Heywood case).
    """

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """Factors from the principal axes of the scatters, followed by a few EM steps."""
        K, n = scatters.shape[:2]
        d = min(structure.n_factors, n - 1)
        eigenvalues, axes = np.linalg.eigh(scatters)
        parts = [principal(eigenvalues[k], axes[k], d, d) for k in range(K)]
        noise = np.maximum(np.stack([noise for _, noise in parts]), _least_noise(structure, scatters))
        return cls(structure, np.stack([loadings for loadings, _ in parts]), noise)._climbed(scatters, START_STEPS)

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """Raise the likelihood by INNER_STEPS steps of EM on the factors."""
        return self._climbed(scatters, INNER_STEPS)

    def _climbed(self, scatters: Array, n_steps: int) -> Self:
        least = np.minimum(_least_noise(self.structure, scatters), self.noise)
        now = self
        for _ in range(n_steps):
            now = now._step(scatters, least)
        return now

    def _step(self, scatters: Array, least: Array) -> Self:
        """One EM step of factor analysis, all components at once (Ghahramani and Hinton 1996, Eqs. 5 and 6).

        With the parameter expansion of Liu, Rubin and Wu (1998): the covariance that the factors have in the samples is
        taken into the loadings, so that EM needs far fewer steps.
        """
        B = self.regressions
        cross = scatters @ np.swapaxes(B, 1, 2)
        second = self.posterior_covariances + B @ cross
        loadings = np.swapaxes(np.linalg.solve(second, np.swapaxes(cross, 1, 2)), 1, 2)
        noise = np.diagonal(scatters, axis1=1, axis2=2) - np.einsum("kid,kid->ki", loadings, cross)
        expanded = loadings @ np.linalg.cholesky(0.5 * (second + np.swapaxes(second, 1, 2)))
        return type(self)(self.structure, expanded, np.maximum(noise, least))

    @property
    def n_parameters(self) -> int:
        """Loadings up to a rotation, and n noises, per component; at most those of a full covariance."""
        K, n, d = self.loadings.shape
        return K * min(n_loadings(n, d) + n, n * (n + 1) // 2)


def _least_noise(structure: Structure, scatters: Array) -> Array:
    """The lower limit (K, n) of the noise: enough for the arithmetic where there is no regularisation."""
    variances = np.diagonal(scatters, axis1=1, axis2=2)
    return np.maximum(structure.reg_covar / len(scatters), 1e-9 * variances)


@dataclass(frozen=True, eq=False)
class PrincipalComponentAnalyzers(LowRankCovariances):
    """Mixture of probabilistic principal component analyzers, Psi_k = sigma_k^2 I (Tipping and Bishop 1999).

    The M-step takes their closed form, with factors and labels integrated out.
    """

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """The closed form for `n_factors` dimensions, at most n - 1."""
        K, n = scatters.shape[:2]
        return cls._principal(structure, scatters, np.full(K, min(structure.n_factors, n - 1)))

    @classmethod
    def start_given(cls, structure: Structure, given: Array, scatters: Array) -> Self:
        """With the numbers of dimensions d_k: the closed form for them."""
        return cls._principal(structure, scatters, given.astype(np.intp))

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """M-step in closed form, with the same numbers of dimensions."""
        return self._principal(self.structure, scatters, self.dimensions)

    @classmethod
    def _principal(cls, structure: Structure, scatters: Array, dimensions: NDArray[np.intp]) -> Self:
        eigenvalues, axes = np.linalg.eigh(scatters)
        columns = int(dimensions.max())
        parts = [principal(eigenvalues[k], axes[k], int(d), columns) for k, d in enumerate(dimensions)]
        return cls(structure, *(np.stack(arrays) for arrays in zip(*parts, strict=True)))

    @property
    def dimensions(self) -> NDArray[np.intp]:
        """Number of factors d_k of each component, (K,): the number of columns of the loadings that are not zero."""
        return np.any(self.loadings != 0.0, axis=1).sum(axis=1)

    @property
    def n_parameters(self) -> int:
        """Loadings up to a rotation, and one noise, per component."""
        n = self.shape[1]
        return sum(n_loadings(n, int(d)) + 1 for d in self.dimensions)


@dataclass(frozen=True, eq=False)
class SubspaceCovariances(PrincipalComponentAnalyzers):
    """The parsimonious model [a_kj b_k Q_k d_k] of Bouveyron and Brunet (2014, Sections 4.2 and 5).

    Each component has its own number of dimensions d_k, found by Cattell's scree test, and one noise outside them.
    After the start d_k only grows: then every M-step maximises over a family that includes the former one, and the
    likelihood never falls.
    """

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """The closed form for the dimensions that the scree test finds in the scatters."""
        return cls._principal(structure, scatters, scree_dimensions(scatters, structure.scree_threshold))

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """M-step in closed form, for the dimensions found in the scatters, or the present ones where these are more."""
        found = scree_dimensions(scatters, self.structure.scree_threshold)
        return self._principal(self.structure, scatters, np.maximum(found, self.dimensions))


def scree_dimensions(scatters: Array, threshold: float) -> NDArray[np.intp]:
    """Numbers of dimensions of components by Cattell's scree test (1966); 0 in one dimension.

    The index, from 1, of the last drop between successive eigenvalues that is at least `threshold` of the largest drop.

    Parameters
    ----------
    scatters
        shape (K, n, n)
    threshold
        share of the largest drop, between 0 and 1

    Returns
    -------
    NDArray[np.intp]
        numbers of dimensions, (K,)
    """
    drops = np.diff(np.linalg.eigvalsh(scatters), axis=1)[:, ::-1]
    if drops.shape[1] == 0:
        return np.zeros(len(scatters), dtype=np.intp)
    large = drops >= threshold * drops.max(axis=1, keepdims=True)
    return drops.shape[1] - np.argmax(large[:, ::-1], axis=1)
