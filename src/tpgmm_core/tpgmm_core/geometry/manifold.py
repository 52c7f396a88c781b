# SPDX-License-Identifier: Apache-2.0
"""Products of Euclidean spaces R^n and the sphere S³ of unit quaternions (Zeestraten et al., RA-L 2017).

Points have ambient coordinates (a quaternion has 4), tangent vectors and covariances have tangent coordinates
(a rotation vector has 3, in radians about the fixed axes): exp_q(w) = Exp(w) ⊗ q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.coordinates import Coordinates
from tpgmm_core.geometry.kernels_manifold import difference, move, transport_matrix


@dataclass(frozen=True)
class Manifold(Coordinates):
    """Product of factors, e.g. `Manifold.parse("R1 x R3 x S3")`; immutable.

    Parameters
    ----------
    factors
        pairs of kind ("R" or "S") and dimension (any for "R", 3 for "S")
    """

    def log(self, base: ArrayLike, x: ArrayLike) -> Array:
        """Tangent vectors from one point to another; q and -q are the same orientation.

        Parameters
        ----------
        base
            points at which the vectors begin, (..., dim)
        x
            points that they lead to, (..., dim)

        Returns
        -------
        Array
            shape (..., tangent_dim)

        Raises
        ------
        ValueError
            for points of another dimension
        """
        base, x = np.asarray(base, dtype=float), np.asarray(x, dtype=float)
        if base.shape[-1:] != (self.dim,) or x.shape[-1:] != (self.dim,):
            raise ValueError(f"points of {self} have shape (..., {self.dim}), got {base.shape} and {x.shape}")
        if self.is_euclidean:
            return x - base
        if base.ndim == x.ndim == 1:  # one pair, as in every control step: compiled (copies have one type of array)
            v = np.empty(self.tangent_dim)
            difference(x.copy(), base.copy(), self.ambient_of_tangent, self.sphere_starts, v)
            return v
        v = np.empty(np.broadcast_shapes(base.shape, x.shape)[:-1] + (self.tangent_dim,))
        v[..., self.flat_tangent] = x[..., self.flat_ambient] - base[..., self.flat_ambient]
        for s in self.spheres:
            turn = quaternion.multiply(x[..., s.ambient], quaternion.conjugate(base[..., s.ambient]))
            v[..., s.tangent] = quaternion.log(turn)
        return v

    def exp(self, base: ArrayLike, v: ArrayLike) -> Array:
        """Points that tangent vectors lead to.

        Parameters
        ----------
        base
            points at which the vectors begin, (..., dim)
        v
            tangent vectors, (..., tangent_dim)

        Returns
        -------
        Array
            shape (..., dim)

        Raises
        ------
        ValueError
            for points and vectors of other dimensions
        """
        base, v = np.asarray(base, dtype=float), np.asarray(v, dtype=float)
        if base.shape[-1:] != (self.dim,) or v.shape[-1:] != (self.tangent_dim,):
            raise ValueError(
                f"points of {self} have shape (..., {self.dim}) and tangent vectors (..., {self.tangent_dim}), "
                f"got {base.shape} and {v.shape}"
            )
        if self.is_euclidean:
            return base + v
        if base.ndim == v.ndim == 1:
            x = base.copy()
            move(x, v.copy(), self.ambient_of_tangent, self.sphere_starts)
            return x
        x = np.empty(np.broadcast_shapes(base.shape[:-1], v.shape[:-1]) + (self.dim,))
        x[..., self.flat_ambient] = base[..., self.flat_ambient] + v[..., self.flat_tangent]
        for s in self.spheres:
            x[..., s.ambient] = quaternion.multiply(quaternion.exp(v[..., s.tangent]), base[..., s.ambient])
        return x

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Length of the shortest way between points, in the units of the tangent vectors.

        Parameters
        ----------
        x, y
            points, (..., dim)

        Returns
        -------
        Array
            shape (...,)
        """
        return np.linalg.norm(self.log(x, y), axis=-1)

    def mean(self, x: ArrayLike, weights: ArrayLike | None = None) -> Array:
        """Weighted mean (dim,) of points: where the weighted tangent vectors to the points cancel out.

        Parameters
        ----------
        x
            points, (N, dim)
        weights
            shape (N,), with a positive sum; None: all points count the same

        Returns
        -------
        Array
            the mean, (dim,)

        Raises
        ------
        ValueError
            for no points, points of another dimension, and weights of another shape or without a positive sum
        """
        x = np.asarray(x, dtype=float)
        if x.ndim != 2 or x.shape[1] != self.dim or not len(x):
            raise ValueError(f"the mean of points of {self} needs points (N, {self.dim}) with N > 0, got {x.shape}")
        w = np.ones(len(x)) if weights is None else np.asarray(weights, dtype=float)
        total = w.sum()
        if w.shape != (len(x),) or not 0.0 < total < np.inf:
            raise ValueError(
                f"the weights of {len(x)} points have shape ({len(x)},) and a positive sum, got shape {w.shape} and "
                f"the sum {total:g}: leave out the weights to have all points count the same"
            )
        w = w / total
        mean = np.asarray(w @ x)
        for s in self.spheres:
            # the main axis of q q^T does not depend on signs, and lies near the mean
            q = x[:, s.ambient]
            mean[s.ambient] = np.linalg.eigh((w[:, None] * q).T @ q)[1][:, -1]
        for _ in range(50 if self.spheres else 0):
            step = w @ self.log(mean, x)
            mean = self.exp(mean, step)
            if np.abs(step).max() < 1e-13:
                break
        return mean

    def transport(self, base: ArrayLike, to: ArrayLike) -> Array:
        """Matrices of parallel transport along the shortest way between points.

        In fixed axes the transport over a rotation w is the rotation by half of it.

        Parameters
        ----------
        base
            points from which tangent vectors are moved, (..., dim)
        to
            points to which they are moved, (..., dim)

        Returns
        -------
        Array
            shape (..., tangent_dim, tangent_dim)
        """
        base, to = np.asarray(base, dtype=float), np.asarray(to, dtype=float)
        if base.ndim == to.ndim == 1:
            T = np.empty((self.tangent_dim, self.tangent_dim))
            transport_matrix(self.log(base, to), self.sphere_starts, T)
            return T
        shape = np.broadcast_shapes(base.shape[:-1], to.shape[:-1])
        T = np.broadcast_to(np.eye(self.tangent_dim), shape + (self.tangent_dim, self.tangent_dim)).copy()
        if not self.is_euclidean:
            v = self.log(base, to)
            for s in self.spheres:
                T[..., s.tangent, s.tangent] = quaternion.rotation_matrix(quaternion.exp(0.5 * v[..., s.tangent]))
        return T

    def tangent_map(self, A: ArrayLike) -> Array:
        """How an ambient frame matrix A acts on tangent vectors.

        A quaternion block L(q) becomes the rotation R(q), whatever the point; Euclidean blocks stay. On a Euclidean
        manifold A may have any number of columns.

        Parameters
        ----------
        A
            shape (..., D, D_j)

        Returns
        -------
        Array
            shape (..., D_tangent, D_j_tangent)

        Raises
        ------
        ValueError
            when the block of an S³ factor is not L(q), or when A mixes it with other coordinates
        """
        A = np.asarray(A, dtype=float)
        if self.is_euclidean:
            return A
        if A.shape[-2:] != (self.dim, self.dim):
            raise ValueError(f"a frame on {self} has a matrix of shape {(self.dim, self.dim)}, got {A.shape[-2:]}")
        tangent = np.zeros(A.shape[:-2] + (self.tangent_dim, self.tangent_dim))
        tangent[..., self.flat_tangent[:, None], self.flat_tangent] = A[
            ..., self.flat_ambient[:, None], self.flat_ambient
        ]
        for s in self.spheres:
            block = A[..., s.ambient, s.ambient]
            q = block[..., :, 3]  # L(q) e_w = q
            off_diagonal = A.copy()
            off_diagonal[..., s.ambient, s.ambient] = 0.0
            mixed = max(
                np.abs(off_diagonal[..., s.ambient, :]).max(initial=0.0),
                np.abs(off_diagonal[..., :, s.ambient]).max(initial=0.0),
            )
            is_left = np.allclose(block, quaternion.left_matrix(q), rtol=0.0, atol=1e-9)
            if mixed > 0.0 or not is_left or not np.allclose(np.sum(q * q, axis=-1), 1.0, rtol=0.0, atol=1e-6):
                raise ValueError(
                    f"the block of an S3 factor (rows {s.ambient.start} to {s.ambient.stop - 1} on {self}) "
                    "must be the left multiplication L(q) by a unit quaternion, mixing with nothing else: "
                    "see Frame.from_pose"
                )
            tangent[..., s.tangent, s.tangent] = quaternion.rotation_matrix(q)
        return tangent


#: Poses [x, y, z, qx, qy, qz, qw]: m, and tangent vectors in m and rad about the fixed axes.
POSE = Manifold.parse("R3 x S3")
