# SPDX-License-Identifier: Apache-2.0
"""Deep mixtures of factor analyzers (Tang, Salakhutdinov and Hinton 2012): how their covariances are kept.

The prior N(0, I) of the factors of each first-level component c is replaced by a mixture of factor analyzers of
its own: x = mu_c + Lambda_c z + noise, z ~ sum_s pi_s N(nu_s, L_s). A component of the deep model is a pair (c, s),
with mean mu_c + Lambda_c nu_s and covariance Lambda_c L_s Lambda_c^T + Psi_c. L_s may have the same form again.

Of poses, factors are coordinates in the tangent space at a component's mean: see `fit_deep_mixture`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.factor_analyzers import FactorAnalyzers
from tpgmm_core.learning.covariance.low_rank import LowRankCovariances, n_loadings
from tpgmm_core.learning.covariance.structure import Structure


@dataclass(frozen=True, eq=False)
class DeepFactorAnalyzers(LowRankCovariances):
    """Sigma_k = base_k L_k base_k^T + diag(noise_k), where base and noise are those of the component's parent.

    The M-step moves L_k, and the means within the range of base_k; base and noise stay as the layer below
    learned them.

    Parameters
    ----------
    structure
        settings of the structure
    loadings
        shape (K, n, d), base_k times a root of L_k
    noise
        shape (K, n), diagonals of Psi_k
    base
        shape (K, n, d), equal for siblings, which follow one another
    latent
        the K covariances L_k (d, d)
    n_parents
        number of components of the layer below
    """

    base: Array
    latent: FactorAnalyzers | DeepFactorAnalyzers
    n_parents: int

    @classmethod
    def assembled(
        cls,
        structure: Structure,
        base: Array,
        noise: Array,
        latent: FactorAnalyzers | DeepFactorAnalyzers,
        n_parents: int,
    ) -> Self:
        """Make one from base, noise and latent covariances, with the loadings that follow from them; see the class.

        Parameters
        ----------
        structure, base, noise, latent, n_parents
            see the class

        Returns
        -------
        Self
            with its loadings
        """
        return cls(structure, base @ np.linalg.cholesky(latent.dense()), noise, base, latent, n_parents)

    @classmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """Refuse to start: deep mixtures start from "mfa" (`fit_deep_mixture`).

        Raises
        ------
        ValueError
            always
        """
        raise ValueError('"deep_mfa" is learned layer by layer, from "mfa": see fit_deep_mixture')

    def maximised(self, counts: Array, scatters: Array) -> Self:
        """M-step of the latent covariances L_k, for the expected scatters of the factors; base and noise stay."""
        R = self._latent_regressions
        latent_scatters = self.latent.dense() - R @ self.base @ self.latent.dense()
        latent_scatters = latent_scatters + R @ scatters @ np.swapaxes(R, 1, 2)
        latent_scatters = 0.5 * (latent_scatters + np.swapaxes(latent_scatters, 1, 2))
        latent = self.latent.maximised(counts, latent_scatters)
        return self.assembled(self.structure, self.base, self.noise, latent, self.n_parents)

    def mean_steps(self, steps: Array) -> Array:
        """Steps (K, n) of the means within the range of base_k: the factors' expected steps, through the layers."""
        expected = np.einsum("kdn,kn->kd", self._latent_regressions, steps)
        return np.einsum("knd,kd->kn", self.base, self.latent.mean_steps(expected))

    @cached_property
    def _latent_regressions(self) -> Array:
        """L base^T Sigma^-1, (K, d, n): the expectation of z - nu, given x - mu."""
        return self.latent.dense() @ self.regressions_of(self.base)

    @property
    def top_loadings(self) -> Array:
        """Product of the loadings of all layers, (K, n, d of the topmost layer)."""
        return self.base @ self.latent.top_loadings

    @classmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        """Read the own arrays, and those of the layers above, whose names begin with "latent_".

        Raises
        ------
        ValueError
            for shapes that do not fit each other
        """
        own = {name: array for name, array in arrays.items() if not name.startswith("latent_")}
        inner = {name.removeprefix("latent_"): array for name, array in arrays.items() if name not in own}
        base, noise, n_parents = own["base"], own["noise"], own["n_parents"]
        kind = DeepFactorAnalyzers if "base" in inner else FactorAnalyzers
        latent = kind.from_arrays(structure, inner)
        K = len(base)
        is_whole = n_parents.shape == (1,) and 1 <= n_parents[0] <= K and K % n_parents[0] == 0
        if base.ndim != 3 or noise.shape != base.shape[:2] or latent.shape != base.shape[::2] or not is_whole:
            raise ValueError(
                f"base (K, n, d), noise (K, n) and latent covariances (K, d) of K / n_parents siblings each, got "
                f"{base.shape}, {noise.shape}, {latent.shape} and n_parents = {n_parents}"
            )
        return cls.assembled(structure, base, noise, latent, int(n_parents[0]))

    def arrays(self) -> dict[str, Array]:
        """`base`, `noise` and `n_parents`, and the arrays of the layers above with "latent_" before their names."""
        inner = {f"latent_{name}": array for name, array in self.latent.arrays().items()}
        return {"base": self.base, "noise": self.noise, "n_parents": np.array([float(self.n_parents)]), **inner}

    @property
    def n_parameters(self) -> int:
        """Free parameters of the parents' loadings and noise, and of the latent covariances."""
        n, d = self.base.shape[1:]
        return self.n_parents * (n_loadings(n, d) + n) + self.latent.n_parameters

    @property
    def n_mean_parameters(self) -> int:
        """Free parameters of the parents' means in n dimensions, and of the latent means."""
        return self.n_parents * self.shape[1] + self.latent.n_mean_parameters


def divided(
    covariances: FactorAnalyzers | DeepFactorAnalyzers, structure: Structure, n_parts: int, top: FactorAnalyzers
) -> DeepFactorAnalyzers:
    """Divide each component into `n_parts`.

    Parameters
    ----------
    covariances
        of the K components
    structure
        settings of the result
    n_parts
        number of parts of each
    top
        covariances of the topmost factors of the K n_parts parts, in place of I

    Returns
    -------
    DeepFactorAnalyzers
        with `n_parts` times as many components
    """
    K = covariances.shape[0]
    noise = np.repeat(covariances.noise, n_parts, axis=0)
    if isinstance(covariances, DeepFactorAnalyzers):
        base, latent = covariances.base, divided(covariances.latent, structure, n_parts, top)
        return DeepFactorAnalyzers.assembled(
            structure, np.repeat(base, n_parts, axis=0), noise, latent, covariances.n_parents
        )
    return DeepFactorAnalyzers.assembled(structure, np.repeat(covariances.loadings, n_parts, axis=0), noise, top, K)
