# SPDX-License-Identifier: Apache-2.0
"""Linear smoothing of a path on a manifold: of each point's neighbours, the weighted mean where the weights say.

On R^n the smoothed path is H x for the matrix H of a linear smoother whose rows add up to 1. On S³ it is the path for
which the same weighted sum of the tangent vectors to the points is zero (a Fréchet mean), and weights may be negative.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold

MAX_STEPS = 50
CONVERGED = 1e-12


def smoothed(space: Manifold, path: Array, weights: Array) -> Array:
    """The smoothed path.

    Parameters
    ----------
    space
        of the points
    path
        (T, D)
    weights
        (n, T, T), for each tangent dimension those of all points at each point; the rows add up to 1

    Returns
    -------
    Array
        (T, D)
    """
    found = path
    for _ in range(MAX_STEPS if space.spheres else 1):
        step = np.einsum("nts,tsn->tn", weights, space.log(found[:, None], path[None]))
        found = space.exp(found, step)
        if np.abs(step).max() < CONVERGED:
            break
    return found


def unrolled(space: Manifold, path: Array) -> Array:
    """What happens along a path (T, D), as numbers (T, n): the sum of the steps from each point to the next."""
    steps = space.log(path[:-1], path[1:])
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
