# SPDX-License-Identifier: Apache-2.0
"""`GaussianMixture`: what a TP-GMM becomes in one situation, and regression on it (GMR)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian, Gaussians
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.split import split


@dataclass(frozen=True, slots=True, eq=False)
class GaussianMixture:
    """Mixture of K Gaussians.

    Parameters
    ----------
    priors
        shape (K,), positive, summing to 1
    means
        shape (K, D), ambient coordinates
    covariances
        shape (K, D_tangent, D_tangent), each in the tangent space at its mean
    manifold
        the space; None means R^D

    Raises
    ------
    ValueError
        for shapes that do not fit
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
        """The k-th Gaussian, without its prior.

        Parameters
        ----------
        k
            from 0

        Returns
        -------
        Gaussian
            over the same space
        """
        return Gaussian(self.means[k], self.covariances[k], self.manifold)

    @classmethod
    def _made(cls, priors: Array, means: Array, covariances: Array, manifold: Manifold) -> Self:
        """Make a mixture of arrays that are known to fit, and that nothing else refers to."""
        made = object.__new__(cls)
        set_priors(made, priors)
        set_means(made, means)
        set_covariances(made, covariances)
        set_manifold(made, manifold)
        return made

    def responsibilities(self, dims: Sequence[int], values: ArrayLike) -> Array:
        """How much each component accounts for values of some of the dimensions.

        Computed in logarithms: the sum over the components is 1 also far from all of them.

        Parameters
        ----------
        dims
            ambient dimensions; the four numbers of a quaternion go together
        values
            shape (..., len(dims))

        Returns
        -------
        Array
            shape (K, ...)
        """
        log_joint = self._log_joint(dims, values)
        joint = np.exp(log_joint - log_joint.max(axis=0))
        return joint / joint.sum(axis=0)

    def log_density(self, x: ArrayLike) -> Array:
        """Logarithm of the density of the mixture.

        Parameters
        ----------
        x
            points, (..., D)

        Returns
        -------
        Array
            shape (...,)
        """
        log_joint = self._log_joint(range(self.manifold.dim), x)
        top = log_joint.max(axis=0)
        return np.asarray(top + np.log(np.exp(log_joint - top).sum(axis=0)))

    def _log_joint(self, dims: Sequence[int], values: ArrayLike) -> Array:
        densities = [self.component(k).marginal(dims).log_density(values) for k in range(len(self.priors))]
        log_priors = np.log(np.maximum(self.priors, np.finfo(float).tiny))
        return np.stack([p + d for p, d in zip(log_priors, densities, strict=True)])

    @overload
    def condition(self, dims: Sequence[int], values: Sequence[float]) -> Gaussian: ...

    @overload
    def condition(self, dims: Sequence[int], values: ArrayLike) -> Gaussian | Gaussians: ...

    def condition(self, dims: Sequence[int], values: ArrayLike) -> Gaussian | Gaussians:
        """Gaussian mixture regression: the other dimensions, given values of some.

        The Gaussian has the first two moments of the conditional mixture. On S³ its mean is where the
        weighted tangent vectors to the components' means cancel out, and their covariances are moved there
        by parallel transport. Compiled; components whose share is below 1e-20 are left out.

        Parameters
        ----------
        dims
            distinct ambient dimensions; the four numbers of a quaternion go together
        values
            shape (len(dims),) for one Gaussian, or (T, len(dims)) for T at once, such as `times[:, None]`

        Returns
        -------
        Gaussian | Gaussians
            of the other dimensions, in their order; `Gaussians`, a sequence of T, for values (T, len(dims))

        Raises
        ------
        ValueError
            for dimensions and values that do not fit, for values that are not finite or so far from all components that
            the distance is not finite, and for a component whose covariance of the dimensions `dims` is singular
        """
        parts = split(self.manifold, tuple(dims))
        given = np.array(values, float, order="C")  # a copy: of one type for the compiled code
        free, n = parts.free, parts.free.tangent_dim
        is_one = given.shape == parts.one
        if not is_one and given.shape[1:] != parts.one:
            raise ValueError(_wrong_shape(parts.given.dim, given.shape))
        priors, means, covariances = self.priors, self.means, self.covariances
        if not (priors.flags.carray and means.flags.carray and covariances.flags.carray):
            # read-only and strided arrays would each be compiled for anew
            priors, means, covariances = priors.copy(), means.copy(), covariances.copy()
        kernels = imported_kernels()
        if is_one and self.manifold.is_euclidean:
            mean, covariance = np.empty(n), np.empty((n, n))
            failed = kernels.condition_one(priors, means, covariances, parts.plan, given, mean, covariance)
            if failed != -1:
                raise ValueError(_refusal(failed, dims, values))
            return Gaussian._made(mean, covariance, free)
        if is_one:
            given = given[None]
        T, is_flat = len(given), free.is_euclidean
        out_means, out_covariances = (
            (np.empty((n, T)), np.empty((n, n, T))) if is_flat else (np.empty((T, free.dim)), np.empty((T, n, n)))
        )
        failed = kernels.condition(
            priors, means, covariances, parts.plan, given, out_means, out_covariances, NOT_WANTED
        )
        if failed != -1:
            raise ValueError(_refusal(failed, dims, values))
        if is_one:
            return Gaussian._made(out_means.reshape(free.dim), out_covariances.reshape(n, n), free)
        if is_flat:
            out_means, out_covariances = out_means.T, out_covariances.transpose(2, 0, 1)
        out_means.setflags(write=False)
        out_covariances.setflags(write=False)
        return Gaussians(out_means, out_covariances, free)


# setters, which a frozen class does not offer
set_priors, set_means, set_covariances, set_manifold = (
    vars(GaussianMixture)[name].__set__ for name in ("priors", "means", "covariances", "manifold")
)


@cache
def imported_kernels() -> Any:
    """Return the compiled regression, imported on first use: most programs that import the core never need it."""
    from tpgmm_core.geometry import kernels_condition

    return kernels_condition


NOT_WANTED: Array = np.empty((0, 0))  # activations


def _wrong_shape(D: int, shape: tuple[int, ...]) -> str:
    """The message for values of D dimensions that have another shape than they may have."""
    hint = ": write values[:, None] for T values of one dimension" if D == 1 and len(shape) == 1 else ""
    return f"values of {D} dimensions have shape ({D},), or (T, {D}) for several at once, got {shape}{hint}"


def _refusal(failed: int, dims: Sequence[int], values: ArrayLike) -> str:
    """The message for an error that `kernels_condition.condition` returned."""
    kernels = imported_kernels()
    if failed == kernels.NOT_FINITE:
        return f"values must be finite, got {values!r}"
    if failed == kernels.TOO_FAR:
        return f"the values {values!r} are so far from all components that the distance is not finite"
    return (
        f"the covariance of component {failed} is not positive definite in the dimensions {list(dims)}: "
        "fit with a larger reg_covar"
    )
