# SPDX-License-Identifier: Apache-2.0
"""One Gaussian on a Euclidean space or on a product with S³: Eqs. (1), (2), (3) and (6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core import quaternion
from tpgmm_core.manifold import Manifold
from tpgmm_core.quaternion import Array

if TYPE_CHECKING:
    from tpgmm_core.frame import Frame


@dataclass(frozen=True, slots=True, eq=False)
class Gaussian:
    """Gaussian with its mean in ambient coordinates (D,) and its covariance in the tangent space at the mean.

    Parameters
    ----------
    mean : shape (D,), D ambient coordinates (quaternions are normalised)
    covariance : shape (D_tangent, D_tangent), symmetric; rotations in rad² about the fixed axes
    manifold : the space; None means R^D

    Raises ValueError for wrong shapes, non-finite numbers or an unsymmetric covariance.
    """

    mean: Array
    covariance: Array
    manifold: Manifold

    def __init__(self, mean: ArrayLike, covariance: ArrayLike, manifold: Manifold | None = None) -> None:
        mean, covariance = np.array(mean, dtype=float), np.array(covariance, dtype=float)
        if mean.ndim != 1:
            raise ValueError(f"a mean has shape (D,), got {mean.shape}")
        manifold = Manifold.euclidean(len(mean)) if manifold is None else manifold
        n = manifold.tangent_dim
        if mean.shape != (manifold.dim,) or covariance.shape != (n, n):
            raise ValueError(
                f"a Gaussian on {manifold} has a mean of shape {(manifold.dim,)} and a covariance of shape {(n, n)}, "
                f"got {mean.shape} and {covariance.shape}"
            )
        if not (np.all(np.isfinite(mean)) and np.all(np.isfinite(covariance))):
            raise ValueError("the mean and the covariance of a Gaussian must be finite")
        if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12):
            raise ValueError("the covariance of a Gaussian must be symmetric")
        for s in manifold.spheres:
            mean[s.ambient] = quaternion.normalize(mean[s.ambient])
        mean.setflags(write=False)
        covariance.setflags(write=False)
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)
        object.__setattr__(self, "manifold", manifold)

    @property
    def precision(self) -> Array:
        """Inverse covariance, shape (D_tangent, D_tangent). Raises ValueError when the covariance is singular."""
        inverse_factor = np.linalg.inv(self._cholesky())
        return inverse_factor.T @ inverse_factor

    def _cholesky(self) -> Array:
        try:
            return np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            raise ValueError("the covariance is not positive definite, so that it has no inverse") from None

    def transform(self, frame: Frame) -> Gaussian:
        """Image under xi = A x + b: N(A mu + b, A Sigma A^T), Eqs. (1) and (2).

        On S³ the covariance turns with the frame. Raises ValueError when the frame varies with time or does not fit.
        """
        if frame.is_time_varying:
            raise ValueError("the frame varies with time: choose one time step with frame.at(t_index)")
        if self.manifold.is_euclidean:
            manifold, tangent = Manifold.euclidean(frame.A.shape[-2]), frame.A
        else:
            manifold, tangent = self.manifold, self.manifold.tangent_map(frame.A)
        if frame.A.shape[-1] != self.manifold.dim:
            raise ValueError(
                f"the frame takes {frame.A.shape[-1]} dimensions, the Gaussian has {self.manifold.dim}"
            )
        covariance = tangent @ self.covariance @ tangent.T
        return Gaussian(frame.A @ self.mean + frame.b, 0.5 * (covariance + covariance.T), manifold)

    @classmethod
    def product(cls, gaussians: Sequence[Gaussian], tol: float = 1e-12, max_iter: int = 100) -> Gaussian:
        """Product of Gaussians: the minimiser of Eq. (3), with the covariance of Eq. (6).

        On S³ the minimiser is found by Gauss-Newton with the inverse left Jacobian of SO(3), halving steps that do
        not lower Eq. (3), until a step is shorter than `tol` (m, rad); the covariance is the inverse of the
        Gauss-Newton Hessian there, in the fixed axes. Raises ValueError for an empty sequence, different manifolds,
        singular covariances, or when `max_iter` steps do not suffice.
        """
        if not gaussians or any(g.manifold != gaussians[0].manifold for g in gaussians):
            raise ValueError("a product takes one or more Gaussians, all on the same manifold")
        manifold = gaussians[0].manifold
        means = np.stack([g.mean for g in gaussians])
        precisions = np.stack([g.precision for g in gaussians])
        # starting at the surest orientation keeps the residuals small; R^n is solved in one step from anywhere
        x = means[np.argmax(np.trace(precisions, axis1=1, axis2=2))]
        cost, gradient, hessian = _eq3(manifold, means, precisions, x)
        for _ in range(max_iter):
            step = -np.linalg.solve(hessian, gradient)
            x = manifold.exp(x, step)
            new_cost, gradient, hessian = _eq3(manifold, means, precisions, x)
            while new_cost > cost * (1.0 + 1e-12) and np.abs(step).max() > tol:
                x = manifold.exp(x, -0.5 * step)
                step = 0.5 * step
                new_cost, gradient, hessian = _eq3(manifold, means, precisions, x)
            cost = new_cost
            if manifold.is_euclidean or np.abs(step).max() < tol:
                covariance = np.linalg.inv(hessian)
                return cls(x, 0.5 * (covariance + covariance.T), manifold)
        raise ValueError(f"the product of the Gaussians did not converge in {max_iter} steps")

    def marginal(self, dims: Sequence[int]) -> Gaussian:
        """Gaussian of the ambient dimensions `dims`, in their order."""
        t = self.manifold.tangent_indices(dims)
        return Gaussian(self.mean[list(dims)], self.covariance[np.ix_(t, t)], self.manifold.subset(dims))

    def condition(self, dims: Sequence[int], values: ArrayLike) -> Gaussian:
        """Gaussian of the other dimensions, given that the ambient dimensions `dims` take `values` (len(dims),).

        On S³ the regression is linear in the tangent spaces, and the covariance is moved to the new mean by
        parallel transport.
        """
        rest = self.manifold.rest(dims)
        i, o = self.manifold.tangent_indices(dims), self.manifold.tangent_indices(rest)
        given, free = self.manifold.subset(dims), self.manifold.subset(rest)
        gain = np.linalg.solve(self.covariance[np.ix_(i, i)], self.covariance[np.ix_(i, o)]).T
        mean = self.mean[rest]
        shifted = free.exp(mean, gain @ given.log(self.mean[list(dims)], values))
        T = free.transport(mean, shifted)
        covariance = T @ (self.covariance[np.ix_(o, o)] - gain @ self.covariance[np.ix_(i, o)]) @ T.T
        return Gaussian(shifted, 0.5 * (covariance + covariance.T), free)

    def log_density(self, x: ArrayLike) -> Array:
        """Logarithm of the density (N,) at points x (N, D), normalised in the tangent space; a scalar for (D,)."""
        factor = self._cholesky()
        difference = self.manifold.log(self.mean, x)
        whitened = np.linalg.solve(factor, difference[..., None])[..., 0]
        log_determinant = 2.0 * np.sum(np.log(np.diagonal(factor)))
        n = self.manifold.tangent_dim
        return -0.5 * (np.sum(whitened**2, axis=-1) + log_determinant + n * np.log(2.0 * np.pi))


def _eq3(manifold: Manifold, means: Array, precisions: Array, x: Array) -> tuple[float, Array, Array]:
    """Half of Eq. (3) at x (D,), its gradient and its Gauss-Newton Hessian in the tangent space at x."""
    errors = manifold.log(means, x)
    J = np.broadcast_to(np.eye(manifold.tangent_dim), precisions.shape).copy()
    for s in manifold.spheres:
        # d Log(Exp(w) Exp(e)) / dw at w = 0 is the inverse of the left Jacobian of SO(3)
        J[:, s.tangent, s.tangent] = inverse_left_jacobian(errors[:, s.tangent])
    weighted = np.einsum("nij,nj->ni", precisions, errors)
    gradient = np.einsum("nji,nj->i", J, weighted)
    hessian = np.einsum("nji,njk,nkl->il", J, precisions, J)
    return 0.5 * float(np.sum(errors * weighted)), gradient, hessian


def inverse_left_jacobian(w: ArrayLike) -> Array:
    """Inverse of the left Jacobian of SO(3) at rotation vectors w (..., 3), shape (..., 3, 3)."""
    w = np.asarray(w, dtype=float)
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    curvature = np.where(
        small, 1.0 / 12.0 + angle**2 / 720.0, (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    )
    zero = np.zeros(w.shape[:-1])
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    cross = np.stack([np.stack(r, axis=-1) for r in [[zero, -z, y], [z, zero, -x], [-y, x, zero]]], axis=-2)
    return np.eye(3) - 0.5 * cross + curvature * (cross @ cross)
