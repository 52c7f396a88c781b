# SPDX-License-Identifier: Apache-2.0
"""One Gaussian on a Euclidean space or on a product with S³: Eqs. (1), (2), (3) and (6)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self, overload

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import kernels_product, quaternion
from tpgmm_core.geometry.disagreement import disagreement
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.kernels_manifold import is_symmetric, normalize_point
from tpgmm_core.geometry.manifold import Manifold


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """Gaussian with its mean in ambient coordinates (D,) and its covariance in the tangent space at the mean.

    Parameters
    ----------
    mean
        shape (D,), D ambient coordinates (quaternions are normalised)
    covariance
        shape (D_tangent, D_tangent), symmetric; rotations in rad² about the fixed axes
    manifold
        the space; None means R^D

    Raises
    ------
    ValueError
        for wrong shapes, non-finite numbers or an unsymmetric covariance
    """

    mean: Array
    covariance: Array
    manifold: Manifold

    def __init__(self, mean: ArrayLike, covariance: ArrayLike, manifold: Manifold | None = None) -> None:
        mean, covariance = np.array(mean, float, order="C"), np.array(covariance, float, order="C")
        if mean.ndim != 1:
            raise ValueError(f"a mean has shape (D,), got {mean.shape}")
        manifold = Manifold.euclidean(len(mean)) if manifold is None else manifold
        n = manifold.tangent_dim
        if mean.shape != (manifold.dim,) or covariance.shape != (n, n):
            raise ValueError(
                f"a Gaussian on {manifold} has a mean of shape {(manifold.dim,)} and a covariance {(n, n)}, "
                f"got {mean.shape} and {covariance.shape}"
            )
        if not (normalize_point(mean, manifold.sphere_starts) and is_symmetric(covariance)):
            _refuse(mean, covariance, manifold)
        mean.setflags(write=False)
        covariance.setflags(write=False)
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)
        object.__setattr__(self, "manifold", manifold)

    @classmethod
    def _made(cls, mean: Array, covariance: Array, manifold: Manifold) -> Self:
        """Make a Gaussian of what a kernel has just computed and checked: in a loop, checks would take most time."""
        mean.setflags(write=False)
        covariance.setflags(write=False)
        made = object.__new__(cls)
        set_mean(made, mean)
        set_covariance(made, covariance)
        set_manifold(made, manifold)
        return made

    @classmethod
    def _of_kernel(cls, mean: Array, covariance: Array, manifold: Manifold) -> Self:
        """`_made`, where numbers may not be finite: then the error says so."""
        if math.isfinite(mean.sum() + covariance.sum()):
            return cls._made(mean, covariance, manifold)
        return cls(mean, covariance, manifold)

    @property
    def precision(self) -> Array:
        """Inverse covariance (D_tangent, D_tangent).

        Raises
        ------
        ValueError
            when the covariance is singular
        """
        inverse_factor = np.linalg.inv(self._cholesky())
        return inverse_factor.T @ inverse_factor

    def _cholesky(self) -> Array:
        try:
            return np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            raise ValueError("the covariance is not positive definite, so that it has no inverse") from None

    def transform(self, frame: Frame) -> Gaussian:
        """Image under xi = A x + b: N(A mu + b, A Sigma A^T), Eqs. (1) and (2).

        On S³ the covariance turns with the frame.

        Parameters
        ----------
        frame
            one map, constant in time

        Returns
        -------
        Gaussian
            over the space that the frame maps to

        Raises
        ------
        ValueError
            for a frame that varies with time or does not fit
        """
        if frame.is_time_varying:
            raise ValueError("the frame varies with time: choose one time step with frame.at(t_index)")
        if self.manifold.is_euclidean:
            manifold, tangent = Manifold.euclidean(frame.A.shape[-2]), frame.A
        else:
            manifold, tangent = self.manifold, self.manifold.tangent_map(frame.A)
        if frame.A.shape[-1] != self.manifold.dim:
            raise ValueError(f"the frame takes {frame.A.shape[-1]} dimensions, the Gaussian has {self.manifold.dim}")
        covariance = tangent @ self.covariance @ tangent.T
        return Gaussian(frame.A @ self.mean + frame.b, 0.5 * (covariance + covariance.T), manifold)

    @classmethod
    def product(cls, gaussians: Sequence[Gaussian]) -> Gaussian:
        """Product of Gaussians: the minimiser of Eq. (3), with the covariance of Eq. (6).

        On S³ the minimiser is found by Gauss-Newton in the tangent space at the present point (Zeestraten et al. 2017;
        Calinon 2020, "Gaussians on Riemannian manifolds"), with the inverse left Jacobian of SO(3) as the exact
        derivative of the logarithm, which takes the place of transporting each covariance there. Steps that do not
        lower Eq. (3) are halved, until one is shorter than 1e-10 (m, rad) or only rounding is left. That takes a few
        steps where orientations agree to some tenths of a rad, and at most 100 (`kernels_product.fuse`). The covariance
        is the inverse of the Gauss-Newton Hessian there, in the fixed axes.

        Parameters
        ----------
        gaussians
            one or more, on one manifold, with regular covariances

        Returns
        -------
        Gaussian
            on the same manifold

        Raises
        ------
        ValueError
            for an empty sequence, different manifolds, singular covariances, or orientations so contradictory that the
            steps do not converge
        """
        if not gaussians or any(g.manifold != gaussians[0].manifold for g in gaussians):
            raise ValueError("a product takes one or more Gaussians, all on the same manifold")
        manifold = gaussians[0].manifold
        means = np.stack([g.mean for g in gaussians])
        precisions = np.stack([g.precision for g in gaussians])
        mean, covariance = means[0].copy(), np.empty_like(precisions[0])
        layout = manifold.ambient_of_tangent, manifold.sphere_starts
        converged = kernels_product.fuse(
            means, precisions, np.ones(len(means)), means[0], 0.0, *layout, mean, covariance
        )
        if not converged:
            named = {f"number {i}": gaussian for i, gaussian in enumerate(gaussians)}
            raise ValueError(f"the Gaussians have no product; {disagreement(named)}")
        return cls(mean, covariance, manifold)

    def marginal(self, dims: Sequence[int]) -> Gaussian:
        """Gaussian of some of the dimensions.

        Parameters
        ----------
        dims
            ambient dimensions, in the order that is wanted; the four numbers of a quaternion go together

        Returns
        -------
        Gaussian
            over `dims`, in this order

        Raises
        ------
        ValueError
            for dimensions out of range or repeated, and when a quaternion would be split
        """
        t = self.manifold.tangent_indices(dims)
        return Gaussian(self.mean[list(dims)], self.covariance[np.ix_(t, t)], self.manifold.subset(dims))

    def condition(self, dims: Sequence[int], values: ArrayLike) -> Gaussian:
        """Gaussian of the other dimensions, given values of some.

        On S³ the regression is linear in the tangent spaces, and the covariance is moved to the new mean by
        parallel transport (Zeestraten et al. 2017).

        Parameters
        ----------
        dims
            ambient dimensions whose values are given; the four numbers of a quaternion go together
        values
            shape (len(dims),)

        Returns
        -------
        Gaussian
            over the other dimensions, in their order

        Raises
        ------
        ValueError
            for dimensions and values that do not fit, and a singular covariance of the dimensions `dims`
        """
        rest = self.manifold.rest(dims)
        i, o = self.manifold.tangent_indices(dims), self.manifold.tangent_indices(rest)
        given, free = self.manifold.subset(dims), self.manifold.subset(rest)
        within = self.covariance[np.ix_(i, i)]
        if not is_positive_definite(within):
            raise ValueError(
                f"the covariance of the given dimensions {list(dims)} is singular, its smallest eigenvalue is "
                f"{np.linalg.eigvalsh(within)[0]:.3g}: fit with a larger reg_covar, or leave out dimensions that "
                "follow from others"
            )
        gain = np.linalg.solve(within, self.covariance[np.ix_(i, o)]).T
        mean = self.mean[rest]
        shifted = free.exp(mean, gain @ given.log(self.mean[list(dims)], values))
        T = free.transport(mean, shifted)
        covariance = T @ (self.covariance[np.ix_(o, o)] - gain @ self.covariance[np.ix_(i, o)]) @ T.T
        return Gaussian(shifted, 0.5 * (covariance + covariance.T), free)

    def log_density(self, x: ArrayLike) -> Array:
        """Logarithm of the density at points, normalised in the tangent space.

        Parameters
        ----------
        x
            points, (N, D)

        Returns
        -------
        Array
            shape (N,)

        Raises
        ------
        ValueError
            when the covariance is singular
        """
        factor = self._cholesky()
        difference = self.manifold.log(self.mean, x)
        whitened = np.linalg.solve(factor, difference[..., None])[..., 0]
        log_determinant = 2.0 * np.sum(np.log(np.diagonal(factor)))
        n = self.manifold.tangent_dim
        return -0.5 * (np.sum(whitened**2, axis=-1) + log_determinant + n * np.log(2.0 * np.pi))


def _refuse(mean: Array, covariance: Array, manifold: Manifold) -> None:
    """Raise the ValueError that says why these numbers are no mean and no covariance."""
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise ValueError("the mean and the covariance of a Gaussian must be finite")
    for s in manifold.spheres:
        quaternion.normalize(mean[s.ambient])  # raises, and says why
    raise ValueError("the covariance of a Gaussian must be symmetric")


def is_positive_definite(S: Array) -> bool:
    """Whether a symmetric matrix (n, n) has a Cholesky factor."""
    try:
        np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return False
    return True


# setters, which a frozen class does not offer
set_mean, set_covariance, set_manifold = (vars(Gaussian)[n].__set__ for n in ("mean", "covariance", "manifold"))


@dataclass(frozen=True, slots=True, eq=False)
class Gaussians(Sequence[Gaussian]):
    """T Gaussians on one space, such as those of a movement at T times: a sequence, kept as two arrays.

    `gaussians[i]` and iteration give each `Gaussian`, `gaussians[a:b]` some of them.

    Parameters
    ----------
    mean
        shape (T, D), read-only
    covariance
        shape (T, D_tangent, D_tangent), read-only
    manifold
        the space
    """

    mean: Array
    covariance: Array
    manifold: Manifold

    def __len__(self) -> int:
        return len(self.mean)

    @overload
    def __getitem__(self, index: int) -> Gaussian: ...

    @overload
    def __getitem__(self, index: slice) -> Gaussians: ...

    def __getitem__(self, index: int | slice) -> Gaussian | Gaussians:
        if isinstance(index, slice):
            return Gaussians(self.mean[index], self.covariance[index], self.manifold)
        # copies, since the arrays may lie otherwise in memory than those of a Gaussian
        return Gaussian._made(self.mean[index].copy(), self.covariance[index].copy(), self.manifold)

    def __iter__(self) -> Iterator[Gaussian]:
        return (self[i] for i in range(len(self)))
