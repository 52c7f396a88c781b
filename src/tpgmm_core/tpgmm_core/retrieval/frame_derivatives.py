# SPDX-License-Identifier: Apache-2.0
"""Frames of points, extended to frames of points with their derivatives."""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame, block_diagonal
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.kernels_adapt import tangent_matrix


def frame_with_derivatives(frame: Frame, manifold: Manifold, orders: int = 1, has_time: bool = False) -> Frame:
    """The frame for [x, derivatives of x], from a frame for points x (D,) on a manifold.

    A derivative is a vector that turns with the frame: A = blkdiag(A_x, A_tangent, ...), b = [b_x, 0, ...], for poses
    blkdiag(R, L(q), R, R). A frame that moves sees velocities in the world, not relative to itself.

    Parameters
    ----------
    frame
        for points x
    manifold
        space of x
    orders
        number of derivatives, tangent vectors (n,) each, on S³ about the fixed axes
    has_time
        whether the frame is over [time, x], and so will be that of the derivatives; time has none

    Returns
    -------
    Frame
        over [x, derivatives of x]; it counts as known exactly

    Raises
    ------
    ValueError
        for a frame that does not fit the manifold
    """
    first = 1 if has_time else 0
    A, inverse = (
        None if M is None else block_diagonal(M, *[_tangent_map(M[..., first:, first:], manifold)] * orders)
        for M in (frame.A, frame.inverse)
    )
    assert A is not None
    b = np.zeros((*frame.b.shape[:-1], A.shape[-2]))
    b[..., : frame.b.shape[-1]] = frame.b
    return Frame(A, b, inverse)


def _tangent_map(A: Array, manifold: Manifold) -> Array:
    """`Manifold.tangent_map`, compiled, for a single matrix."""
    if A.shape == (manifold.dim, manifold.dim):
        tangent = np.empty((manifold.tangent_dim, manifold.tangent_dim))
        if tangent_matrix(np.ascontiguousarray(A), manifold.ambient_of_tangent, manifold.sphere_starts, tangent):
            return tangent
    return manifold.tangent_map(A)
