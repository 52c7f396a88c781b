# SPDX-License-Identifier: Apache-2.0
"""`Coordinates`: where the numbers of points and tangent vectors of a product of R^n and S³ lie.

Points have ambient coordinates (a quaternion has 4), tangent vectors and covariances have tangent coordinates
(a rotation vector has 3). `manifold.py` adds the geometry.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.text import shown

MAX_TEXT = 1000
"""Longest text of a manifold, in characters: it may come from messages and files of others."""


@dataclass(frozen=True, slots=True)
class Sphere:
    """Where one S³ factor lies: the slices of its 4 ambient and of its 3 tangent coordinates."""

    ambient: slice
    tangent: slice


@dataclass(frozen=True)
class Coordinates:
    """The factors of a manifold, and the indices of their coordinates; immutable.

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
    def parse(cls, text: str, dim: int | None = None) -> Self:
        """Make the manifold of a text such as "R1 x R3 x S3", or "euclidean", which is R^dim.

        Parameters
        ----------
        text
            factors "R" or "S" with their dimensions, separated by " x "
        dim
            number of ambient dimensions that it must have; None: any

        Returns
        -------
        Self
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
    def euclidean(cls, dim: int) -> Self:
        """R^dim.

        Parameters
        ----------
        dim
            number of dimensions, at least 1

        Returns
        -------
        Self
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

    def subset(self, dims: Sequence[int]) -> Self:
        """Manifold of some of the ambient indices, in their order.

        Parameters
        ----------
        dims
            ambient indices; the four of a quaternion go together

        Returns
        -------
        Self
            the manifold of these dimensions

        Raises
        ------
        ValueError
            for indices out of range or repeated, and when a quaternion would be split
        """
        return _subset(self, tuple(dims))

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

    def __getstate__(self) -> dict[str, object]:
        return {"factors": self.factors}  # the rest is worked out anew


@lru_cache(maxsize=256)  # worked out once for the same dimensions, with all that the subset keeps of itself
def _subset[SpaceT: Coordinates](space: SpaceT, dims: tuple[int, ...]) -> SpaceT:
    return type(space)(space._select(dims)[0])
