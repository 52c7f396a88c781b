# SPDX-License-Identifier: Apache-2.0
"""Frames of points, extended to frames of points with their derivatives."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame, block_diagonal
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.kernels_adapt import tangent_matrix
from tpgmm_core.retrieval.frames import check_time_kept, without_time


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


def frames_with_derivatives(
    frames: Mapping[str, Frame], manifold: Manifold, orders: int, keeps_time: bool
) -> dict[str, Frame]:
    """Frames over [time, x], for [x, derivatives of x] with or without time; compiled, as every change needs it.

    Parameters
    ----------
    frames
        over [time, x], by name
    manifold
        space of x
    orders
        as for `frame_with_derivatives`
    keeps_time
        whether the result is over [time, x, derivatives]

    Returns
    -------
    dict[str, Frame]
        as of `frame_with_derivatives`

    Raises
    ------
    ValueError
        for frames that change time or mix it with others, and that do not fit the manifold
    """
    D, layout = manifold.dim, (manifold.ambient_of_tangent, manifold.sphere_starts)
    first, result = int(keeps_time), {}
    size = first + D + orders * manifold.tangent_dim
    for name, frame in frames.items():
        if frame.inverse is None and frame.A.shape == (1 + D, 1 + D):
            A, b = np.zeros((size, size)), np.zeros(size)
            if extend(np.array(frame.A, order="C"), np.array(frame.b), first, orders, *layout, A, b):
                result[name] = Frame._made(A, b)
                continue
        check_time_kept(name, frame)
        if keeps_time:
            result[name] = frame_with_derivatives(frame, manifold, orders, has_time=True)
        else:
            result[name] = frame_with_derivatives(without_time({name: frame})[name], manifold, orders)
    return result


@compiled
def extend(
    A: Array, b: Array, first: int, orders: int, flat: Array, spheres: Array, out_A: Array, out_b: Array
) -> bool:
    """`frame_with_derivatives` of a frame over [time, x].

    Parameters
    ----------
    A, b
        (1 + D, 1 + D) and (1 + D,)
    first
        1 where time is kept, else 0
    orders
        number of derivatives
    flat, spheres
        arrangement of the manifold of x, see `kernels_manifold`
    out_A, out_b
        (first + D + orders n, the same) and (first + D + orders n,), zeros; written

    Returns
    -------
    bool
        False where the frame changes time, or does not fit the manifold
    """
    D, n = len(b) - 1, len(flat)
    if A[0, 0] != 1.0 or b[0] != 0.0:
        return False
    for i in range(1, D + 1):
        if A[0, i] != 0.0 or A[i, 0] != 0.0:
            return False
    data, tangent = np.empty((D, D)), np.empty((n, n))
    for i in range(D):
        out_b[first + i] = b[1 + i]
        for m in range(D):
            data[i, m] = A[1 + i, 1 + m]
            out_A[first + i, first + m] = A[1 + i, 1 + m]
    if not tangent_matrix(data, flat, spheres, tangent):
        return False
    if first == 1:
        out_A[0, 0] = 1.0
    for order in range(orders):
        begin = first + D + order * n
        for i in range(n):
            for m in range(n):
                out_A[begin + i, begin + m] = tangent[i, m]
    return True


def _tangent_map(A: Array, manifold: Manifold) -> Array:
    """`Manifold.tangent_map`, compiled, for a single matrix."""
    if A.shape == (manifold.dim, manifold.dim):
        tangent = np.empty((manifold.tangent_dim, manifold.tangent_dim))
        if tangent_matrix(np.ascontiguousarray(A), manifold.ambient_of_tangent, manifold.sphere_starts, tangent):
            return tangent
    return manifold.tangent_map(A)
