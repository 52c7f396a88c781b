# SPDX-License-Identifier: Apache-2.0
"""Damped pseudo-inverses and null spaces, compiled: the operators of Eqs. (8) to (12).

The law of damping: a singular value s of J becomes s / max(s, s0)² in the inverse, each for itself. From s0 on this is
1 / s, the exact pseudo-inverse; below, it falls to zero in proportion to s. As an odd continuous function of
singular values it makes the inverse a continuous function of J, also where s passes through zero and its vectors
change sign, and none of its entries exceeds 1 / s0. (In terms of damped least squares, s / (s² + l²), with a damping of
its own for each singular value as by Maciejewski and Klein 1988, it is l² = s0² - s² below s0, as by Chiaverini 1997.)

No inverse of the damped inverse is continuous and bounded. So frames take J itself to see with: see `frames.py`.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled

#: s0: singular values of Jacobians below it are damped; m/rad for positions, rad/rad for orientations.
THRESHOLD = 0.05


@compiled
def damped_gram_inverse(J: Array, threshold: float) -> Array:
    """Damped inverse (J J^T)^-1 (m, m) of J (m, n): eigenvalues s² below threshold² are replaced by threshold²."""
    values, vectors = np.linalg.eigh(J @ J.T)
    scaled = vectors / np.maximum(values, threshold * threshold)
    return scaled @ np.ascontiguousarray(vectors.T)


@compiled
def damped_pseudo_inverse(J: Array, threshold: float) -> Array:
    """Damped pseudo-inverse J^+ (n, m) of J (m, n), C-ordered; m may exceed n, and rows may depend on each other."""
    return np.ascontiguousarray(J.T) @ damped_gram_inverse(J, threshold)


@compiled
def null_space(J: Array, threshold: float) -> Array:
    """Projection N = I - J^+ J on motions that J does not see.

    Near singularities, where damping leaves some of a motion undone, its eigenvalues lie between 0 and 1.

    Parameters
    ----------
    J
        shape (m, n)
    threshold
        singular values below it are damped

    Returns
    -------
    Array
        shape (n, n), symmetric
    """
    return np.eye(J.shape[1]) - damped_pseudo_inverse(J, threshold) @ J
