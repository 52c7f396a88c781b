# SPDX-License-Identifier: Apache-2.0
"""Bases (synergies) of a model with semi-tied covariances, for a model of another task (Section 4 of the paper)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.stored_mixture import StoredMixture

type Bases = StoredMixture | Mapping[str, ArrayLike]
"""A model with semi-tied covariances, or name of a frame → transform A = H^-1."""


def transforms_of(bases: Bases, manifolds: Mapping[str, Manifold]) -> dict[str, Array]:
    """One transform for each frame of the data, as it was learned, to the last bit.

    Parameters
    ----------
    bases
        a fitted model, or transforms; it may have more frames
    manifolds
        name → space of what that frame sees

    Returns
    -------
    dict[str, Array]
        name → A, shape (n_j, n_j): copies

    Raises
    ------
    ValueError
        for a model of other covariances or spaces, frames that it does not have, and matrices that are not regular
    """
    if isinstance(bases, StoredMixture):
        found = _learned(bases, manifolds)
    elif isinstance(bases, Mapping):
        found = {name: np.array(A, dtype=float) for name, A in bases.items()}
    else:
        raise ValueError(f"bases are a model with semi-tied covariances, or one matrix per frame, got {shown(bases)}")
    missing = [name for name in manifolds if name not in found]
    if missing:
        raise ValueError(f"there are no bases for {listed(missing)}; there are some for {listed(found)}")
    for name, manifold in manifolds.items():
        A, n = found[name], manifold.tangent_dim
        if A.shape != (n, n) or not np.all(np.isfinite(A)) or np.linalg.matrix_rank(A) < n:
            raise ValueError(f"the basis of frame {shown(name)} is a regular matrix {(n, n)}, got {A.shape}")
    return {name: found[name] for name in manifolds}


def dimensions_of(
    n_factors: Mapping[str, ArrayLike], n_components: int, manifolds: Mapping[str, Manifold]
) -> dict[str, Array]:
    """Numbers of factors of each component in each frame of the data.

    Parameters
    ----------
    n_factors
        name → shape (K,), such as `DPMeans.dimensions_`
    n_components
        K
    manifolds
        name → space of what that frame sees

    Returns
    -------
    dict[str, Array]
        name → d, shape (K,), integers

    Raises
    ------
    ValueError
        for another number of components, frames without numbers, and numbers that are none from 0 to n_j - 1
    """
    found = {}
    for name, manifold in manifolds.items():
        d, n = np.asarray(n_factors.get(name, ())), manifold.tangent_dim
        if d.shape != (n_components,) or d.dtype.kind not in "iu" or d.min() < 0 or d.max() >= n:
            expected = f"{n_components} integers from 0 to {n - 1}"
            raise ValueError(f"n_factors of frame {shown(name)} are {expected}, got {shown(d.tolist())}")
        found[name] = d
    return found


def _learned(model: StoredMixture, manifolds: Mapping[str, Manifold]) -> dict[str, Array]:
    emissions = model.emissions_
    if emissions.structure.name != "semi_tied":
        raise ValueError(
            f"the model given for its bases has {emissions.structure.name} covariances; learn it with "
            'covariance "semi_tied"'
        )
    for name, manifold in manifolds.items():
        space = emissions.manifolds.get(name, manifold)
        if str(space) != str(manifold):
            raise ValueError(f"frame {shown(name)} sees {manifold}, but {space} in the model given for its bases")
    return {name: frame.arrays()["transform"].copy() for name, frame in emissions.frames.items()}
