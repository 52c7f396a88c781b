# SPDX-License-Identifier: Apache-2.0
"""`split`: the dimensions of a manifold that are given and those that are free, as regression needs them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.geometry.manifold import Manifold


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Dimensions of a manifold that are given and those that are free, in the form that regression needs.

    Parameters
    ----------
    given, free
        the manifolds of both
    one
        shape (D_i,) of one value of what is given
    plan
        the same as `kernels_condition.plan_parts` reads it
    """

    given: Manifold
    free: Manifold
    one: tuple[int]
    plan: NDArray[np.int64]


@lru_cache(maxsize=256)  # worked out once for the same dimensions, not at every step
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
    return Split(given, free, (given.dim,), np.concatenate([np.asarray(part, dtype=np.int64) for part in parts]))
