# SPDX-License-Identifier: Apache-2.0
"""What a covariance structure is: its settings (`Structure`), and the K covariances of one frame (`Covariances`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from tpgmm_core.common.constants import LOG_2PI
from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array

STRUCTURES = ("full", "diag", "spherical", "tied", "mfa", "mppca", "hddc", "semi_tied", "deep_mfa")
OPTIONS = ("scree_threshold", "layers")
"""Settings of single structures: what `covariance_options` of an estimator may hold."""


@dataclass(frozen=True, slots=True)
class Structure:
    """Name and settings of a covariance structure; the same for all components and frames.

    Parameters
    ----------
    name
        one of `STRUCTURES`
    n_factors
        d, columns of the loadings of "mfa", "mppca" and the first level of "deep_mfa"; at most n - 1 in a frame of n
        dimensions. Other structures ignore it
    reg_covar
        variance that the regularisation adds, in squared units of the data
    regularization
        "add" or "prior": see `Emissions.penalty`
    scree_threshold
        "hddc" keeps the dimensions up to the last drop between successive eigenvalues that exceeds this share of the
        largest drop
    layers
        of "deep_mfa", above the first: pairs of the number of components into which each component of the layer below
        is divided, and of the columns of their loadings
    fixed_bases
        whether the transforms of "semi_tied" are given, such as those of another task, and stay as they are

    Raises
    ------
    ValueError
        for values outside their range
    """

    name: str = "full"
    n_factors: int = 1
    reg_covar: float = 1e-4
    regularization: str = "add"
    scree_threshold: float = 0.2
    layers: tuple[tuple[int, int], ...] = ((2, 1),)
    fixed_bases: bool = False

    def __post_init__(self) -> None:
        if self.name not in STRUCTURES:
            raise ValueError(f"a covariance structure is one of {', '.join(STRUCTURES)}, got {shown(self.name)}")
        if not _is_count(self.n_factors):
            raise ValueError(f"n_factors is an integer from 1, got {shown(self.n_factors)}")
        if not self.layers or not all(len(layer) == 2 and all(map(_is_count, layer)) for layer in self.layers):
            raise ValueError(f"layers are pairs (components, factors) of integers from 1, got {shown(self.layers)}")
        if not (np.isfinite(self.reg_covar) and self.reg_covar >= 0.0):
            raise ValueError(f"reg_covar is a finite number from 0, got {self.reg_covar!r}")
        if self.regularization not in ("add", "prior"):
            raise ValueError(f'regularization is "add" or "prior", got {shown(self.regularization)}')
        if self.fixed_bases and self.name != "semi_tied":
            raise ValueError(f'bases are of covariance "semi_tied", got {shown(self.name)}')
        if not 0.0 < self.scree_threshold < 1.0:
            raise ValueError(f"scree_threshold is between 0 and 1, got {self.scree_threshold!r}")


def _is_count(value: object) -> bool:
    return bool(isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= 1)


class Covariances(ABC):
    """K covariances (n, n) of one structure, in the tangent space of one frame; immutable.

    Subclasses define how they are stored, and how they follow from weighted scatters (the M-step).
    """

    arrays_of: ClassVar[tuple[str, ...]]
    """Names of the attributes that hold the parameters: what a model file keeps."""

    structure: Structure

    @classmethod
    @abstractmethod
    def start(cls, structure: Structure, counts: Array, scatters: Array) -> Self:
        """Covariances to start EM from, near the scatters.

        Parameters
        ----------
        structure
            settings of the structure
        counts
            shape (K,), number of samples of each component
        scatters
            shape (K, n, n)

        Returns
        -------
        Self
            of this structure
        """

    @classmethod
    def start_given(cls, structure: Structure, given: Array, scatters: Array) -> Self:
        """Covariances to start EM from, the likeliest ones for scatters with a part that EM then keeps.

        Parameters
        ----------
        structure
            settings of the structure
        given
            the part: of "semi_tied" with `fixed_bases` the transform A, of "mppca" the numbers of factors (K,)
        scatters
            shape (K, n, n)

        Returns
        -------
        Self
            of this structure

        Raises
        ------
        ValueError
            for a structure of which no part can be given
        """
        raise ValueError(f"no part of the structure {structure.name} can be given")

    @abstractmethod
    def maximised(self, counts: Array, scatters: Array) -> Self:
        """M-step: raises -1/2 sum_k counts_k (log|Sigma_k| + tr(Sigma_k^-1 S_k)), or keeps it.

        Parameters
        ----------
        counts
            shape (K,), weight of the samples of each component
        scatters
            S, shape (K, n, n), covariances of the weighted samples about the means, regularised. For a component
            without samples S is its own covariance

        Returns
        -------
        Self
            of this structure
        """

    @classmethod
    @abstractmethod
    def from_arrays(cls, structure: Structure, arrays: Mapping[str, Array]) -> Self:
        """Make covariances from the arrays that `arrays` gave.

        Parameters
        ----------
        structure
            settings of the structure
        arrays
            by name

        Returns
        -------
        Self
            of this structure

        Raises
        ------
        ValueError
            when they do not fit together
        """

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """Number of components K, and of tangent dimensions n."""

    @cached_property
    @abstractmethod
    def log_determinants(self) -> Array:
        """log|Sigma_k|, (K,)."""

    @abstractmethod
    def squared_distances(self, k: int, d: Array) -> Array:
        """Squared Mahalanobis distances d Sigma_k^-1 d^T (N,) of tangent differences d (N, n)."""

    @abstractmethod
    def dense(self) -> Array:
        """The covariances Sigma as full matrices, (K, n, n)."""

    @abstractmethod
    def inverse_traces(self) -> Array:
        """tr(Sigma_k^-1), (K,)."""

    @property
    @abstractmethod
    def n_parameters(self) -> int:
        """Free parameters of all K covariances together."""

    @property
    def n_mean_parameters(self) -> int:
        """Free parameters of the K means."""
        K, n = self.shape
        return K * n

    def mean_steps(self, steps: Array) -> Array:
        """How far the means move, (K, n), when the weighted samples lie `steps` (K, n) away: here by all of it."""
        return steps

    def log_density(self, k: int, d: Array) -> Array:
        """Log-density log N(d; 0, Sigma_k), (N,), of tangent differences d (N, n)."""
        log_norm = -0.5 * (self.shape[1] * LOG_2PI + self.log_determinants[k])
        return np.asarray(log_norm - 0.5 * self.squared_distances(k, d))

    def log_densities(self, x: Array, means: Array) -> Array:
        """Log-densities log N(x_n; mu_k, Sigma_k), (N, K), of points x (N, n) of R^n and means (K, n)."""
        return np.stack([self.log_density(k, x - mean) for k, mean in enumerate(means)], axis=1)

    def arrays(self) -> dict[str, Array]:
        """The parameters as named arrays of numbers."""
        return {name: getattr(self, name) for name in self.arrays_of}
