# SPDX-License-Identifier: Apache-2.0
"""Products of Euclidean spaces R^n and the sphere S³ of unit quaternions (Zeestraten et al., RA-L 2017).

Points have ambient coordinates (a quaternion has 4), tangent vectors and covariances have tangent coordinates
(a rotation vector has 3, in radians about the fixed axes): exp_q(w) = Exp(w) ⊗ q.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.kernels_manifold import difference, move

MAX_TEXT = 1000
"""Longest text of a manifold, in characters: it may come from messages and files of others."""


@dataclass(frozen=True, slots=True)
class Sphere:
    """Where one S³ factor lies: the slices of its 4 ambient and of its 3 tangent coordinates."""

    ambient: slice
    tangent: slice


@dataclass(frozen=True)
class Manifold:
    """Product of factors, e.g. `Manifold.parse("R1 x R3 x S3")`; immutable.

    Parameters
    ----------
    factors
        pairs of kind ("R" or "S") and dimension (any for "R", 3 for "S")
    """

    factors: tuple[tuple[str, int], ...]

    def __post_init__(self) -> None:
        for kind, n in self.factors:
            if not (kind == "R" and n > 0) and (kind, n) != ("S", 3):
                raise ValueError(f"a factor of a manifold is R1, R2, ... or S3, got {kind}{n}")

    @classmethod
    @lru_cache(maxsize=256)  # everything about a manifold is computed once, not for every message
    def parse(cls, text: str, dim: int | None = None) -> Manifold:
        """Make the manifold of a text such as "R1 x R3 x S3", or "euclidean", which is R^dim.

        Parameters
        ----------
        text
            factors "R" or "S" with their dimensions, separated by " x "
        dim
            number of ambient dimensions that it must have; None: any

        Returns
        -------
        Manifold
            the manifold

        Raises
        ------
        ValueError
            when the text is not understood, or has not `dim` ambient dimensions (where given)
        """
        if len(text) > MAX_TEXT:
            raise ValueError(f"a manifold is a text of at most {MAX_TEXT} characters, got {len(text)}")
        if text.strip().lower() == "euclidean":
            if dim is None:
                raise ValueError('"euclidean" leaves the dimension open: give dim, or write "R3"')
            return cls.euclidean(dim)
        factors = []
        for part in text.split("x"):
            match = re.fullmatch(r"\s*([RS])(\d+)\s*", part)
            if match is None:
                raise ValueError(f'a manifold is "euclidean" or a product such as "R1 x R3 x S3", got {shown(text)}')
            factors.append((match[1], int(match[2])))
        manifold = cls(tuple(factors))
        if dim is not None and manifold.dim != dim:
            raise ValueError(f"the manifold {shown(text)} has {manifold.dim} ambient dimensions, expected {dim}")
        return manifold

    @classmethod
    @lru_cache(maxsize=256)
    def euclidean(cls, dim: int) -> Manifold:
        """R^dim.

        Parameters
        ----------
        dim
            number of dimensions, at least 1

        Returns
        -------
        Manifold
            with the one factor R^dim
        """
        return cls((("R", dim),))

    def __str__(self) -> str:
        return " x ".join(f"{kind}{n}" for kind, n in self.factors)

    @cached_property
    def dim(self) -> int:
        """Number of ambient coordinates."""
        return sum(4 if kind == "S" else n for kind, n in self.factors)

    @cached_property
    def tangent_dim(self) -> int:
        """Number of tangent coordinates."""
        return sum(n for _, n in self.factors)

    @property
    def is_euclidean(self) -> bool:
        """Whether there is no S³ factor, so that ambient and tangent coordinates are the same."""
        return not self.spheres

    @cached_property
    def spheres(self) -> tuple[Sphere, ...]:
        """The S³ factors in their order."""
        ambient = tangent = 0
        spheres = []
        for kind, n in self.factors:
            size = 4 if kind == "S" else n
            if kind == "S":
                spheres.append(Sphere(slice(ambient, ambient + 4), slice(tangent, tangent + 3)))
            ambient, tangent = ambient + size, tangent + n
        return tuple(spheres)

    @cached_property
    def flat_ambient(self) -> NDArray[np.intp]:
        """Ambient indices of the Euclidean coordinates, in order."""
        spherical = [i for s in self.spheres for i in range(s.ambient.start, s.ambient.stop)]
        return np.setdiff1d(np.arange(self.dim), spherical)

    @cached_property
    def flat_tangent(self) -> NDArray[np.intp]:
        """Tangent indices of the Euclidean coordinates, in order."""
        spherical = [i for s in self.spheres for i in range(s.tangent.start, s.tangent.stop)]
        return np.setdiff1d(np.arange(self.tangent_dim), spherical)

    @cached_property
    def ambient_of_tangent(self) -> NDArray[np.int64]:
        """Ambient index of each tangent dimension, or -1 on S³: the arrangement that the compiled kernels take."""
        indices = np.full(self.tangent_dim, -1, dtype=np.int64)
        indices[self.flat_tangent] = self.flat_ambient
        return indices

    @cached_property
    def sphere_starts(self) -> NDArray[np.int64]:
        """First ambient and first tangent index of each S³ factor, (S, 2), for the compiled kernels."""
        return np.array([[s.ambient.start, s.tangent.start] for s in self.spheres], dtype=np.int64).reshape(-1, 2)

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
        """
        base, x = np.asarray(base, dtype=float), np.asarray(x, dtype=float)
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
        """
        base, v = np.asarray(base, dtype=float), np.asarray(v, dtype=float)
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
            shape (N,); None: all points count the same

        Returns
        -------
        Array
            the mean, (dim,)
        """
        x = np.asarray(x, dtype=float)
        w = np.ones(len(x)) if weights is None else np.asarray(weights, dtype=float)
        w = w / w.sum()
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

    def tangent_indices(self, dims: Sequence[int]) -> NDArray[np.intp]:
        """Tangent indices of the ambient indices `dims`.

        Parameters
        ----------
        dims
            ambient indices, as for `subset`

        Returns
        -------
        NDArray[np.intp]
            in the order of `dims`; three for the four numbers of a quaternion

        Raises
        ------
        ValueError
            like `subset`
        """
        return self._select(dims)[1]

    def subset(self, dims: Sequence[int]) -> Manifold:
        """Manifold of some of the ambient indices, in their order.

        Parameters
        ----------
        dims
            ambient indices; the four of a quaternion go together

        Returns
        -------
        Manifold
            the manifold of these dimensions

        Raises
        ------
        ValueError
            for indices out of range or repeated, and when a quaternion would be split
        """
        return Manifold(self._select(dims)[0])

    @cached_property
    def split(self) -> Callable[[tuple[int, ...]], Split]:
        """`split` of this manifold, which is worked out once for the same dimensions, not at every step."""
        return lru_cache(maxsize=64)(partial(split, self))

    def __getstate__(self) -> dict[str, object]:
        return {"factors": self.factors}  # the rest is worked out anew

    def rest(self, dims: Sequence[int]) -> list[int]:
        """The ambient indices that are not in `dims`, in their order.

        Parameters
        ----------
        dims
            ambient indices

        Returns
        -------
        list[int]
            ascending
        """
        return [i for i in range(self.dim) if i not in set(dims)]

    def _select(self, dims: Sequence[int]) -> tuple[tuple[tuple[str, int], ...], NDArray[np.intp]]:
        dims = [int(i) for i in dims]
        if not dims or len(set(dims)) != len(dims) or not all(0 <= i < self.dim for i in dims):
            raise ValueError(f"dimensions of {self} are distinct indices 0 to {self.dim - 1}, got {dims}")
        tangent_of = dict(zip(self.flat_ambient.tolist(), self.flat_tangent.tolist(), strict=True))
        sphere_of = {s.ambient.start: s for s in self.spheres}
        factors: list[tuple[str, int]] = []
        tangent: list[int] = []
        i = 0
        while i < len(dims):
            sphere = sphere_of.get(dims[i])
            if sphere is not None and dims[i : i + 4] == list(range(sphere.ambient.start, sphere.ambient.stop)):
                factors.append(("S", 3))
                tangent += range(sphere.tangent.start, sphere.tangent.stop)
                i += 4
            elif dims[i] in tangent_of:
                run = factors and factors[-1][0] == "R"
                factors[-1:] = [("R", factors[-1][1] + 1)] if run else factors[-1:] + [("R", 1)]
                tangent.append(tangent_of[dims[i]])
                i += 1
            else:
                raise ValueError(f"the dimensions {dims} of {self} split a quaternion; take its four numbers together")
        return tuple(factors), np.array(tangent, dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Dimensions of a manifold that are given and those that are free, in the form that regression needs.

    Parameters
    ----------
    given, free
        the manifolds of both
    plan
        the same as `kernels_condition.plan_parts` reads it
    """

    given: Manifold
    free: Manifold
    plan: NDArray[np.int64]


def split(manifold: Manifold, dims: tuple[int, ...]) -> Split:
    """Divide a manifold into the dimensions `dims`, which are given, and the others, which are free.

    Parameters
    ----------
    manifold
        the whole space
    dims
        ambient dimensions; the four numbers of a quaternion go together

    Returns
    -------
    Split
        the manifolds of both parts, and the plan of the regression

    Raises
    ------
    ValueError
        like `Manifold.subset`, and where no dimension is left
    """
    rest = manifold.rest(dims)
    given, free = manifold.subset(dims), manifold.subset(rest)
    sizes = [given.tangent_dim, free.tangent_dim, given.dim, free.dim, len(given.spheres), len(free.spheres)]
    parts = [sizes, manifold.tangent_indices(dims), manifold.tangent_indices(rest), dims, rest]
    parts += [given.ambient_of_tangent, free.ambient_of_tangent]
    parts += [given.sphere_starts.ravel(), free.sphere_starts.ravel()]
    return Split(given, free, np.concatenate([np.asarray(part, dtype=np.int64) for part in parts]))


#: Poses [x, y, z, qx, qy, qz, qw]: m, and tangent vectors in m and rad about the fixed axes.
POSE = Manifold.parse("R3 x S3")
