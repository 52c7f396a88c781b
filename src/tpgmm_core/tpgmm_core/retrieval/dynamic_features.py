# SPDX-License-Identifier: Apache-2.0
"""Dynamic features: demonstrations with their velocities and accelerations, as frames see them.

A frame x = A y + b sees the velocity of y and of x differently: with T the action of A on tangent vectors
(`Manifold.tangent_map`), omega and alpha the frame's own angular velocity and acceleration about the fixed axes,

    v = T v_y + A' y + b',   a = T a_y + 2 A' v_y + A'' y + b''     on R^n
    v = T v_y + omega,       a = T a_y + omega x T v_y + alpha      on S³

so that time, point, velocity and acceleration together go through one affine map, an ordinary `Frame`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.retrieval.differences import derivatives, difference_weights
from tpgmm_core.retrieval.frame_derivatives import frame_with_derivatives, frames_with_derivatives
from tpgmm_core.retrieval.frames import without_time


def manifold_with_derivatives(manifold: str | Manifold) -> Manifold:
    """The manifold of [time, point, velocity, acceleration], for that of [time, point]: "R1 x R3 x S3" → "… x R12"."""
    space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold)
    return Manifold((*space.factors, ("R", 2 * (space.tangent_dim - 1))))


@cache
def point_manifold(manifold: Manifold) -> Manifold:
    """The manifold of the point alone.

    Parameters
    ----------
    manifold
        of [time, point, velocity, acceleration]

    Returns
    -------
    Manifold
        of the point

    Raises
    ------
    ValueError
        for one that `manifold_with_derivatives` does not give
    """
    n, rest = divmod(manifold.tangent_dim - 1, 3)
    D = n + len(manifold.spheres)
    is_dynamic = n > 0 and rest == 0 and manifold.factors[0][0] == "R"
    if not is_dynamic or any(s.ambient.stop > 1 + D for s in manifold.spheres):
        raise ValueError(
            "a model with dynamic features has 1 + 3 d dimensions: time, a point of d tangent dimensions, its velocity "
            f"and its acceleration (see with_derivatives, manifold_with_derivatives), got {manifold}"
        )
    return manifold.subset(range(1, 1 + D))


def with_derivatives(
    demonstration: Demonstration, manifold: str | Manifold = "euclidean", window: int = 9
) -> Demonstration:
    """The demonstration with velocities and accelerations, for a `TPGMM` that `TrajectoryModel` retrieves from.

    Data become (T, 1 + D + 2 n), in 1/s and 1/s², on S³ rad/s and rad/s² about the fixed axes. A frame that moves sees
    velocities relative to its own motion; where it was not seen during a whole window, its motion is not known, and it
    counts as not seen.

    Parameters
    ----------
    demonstration
        data (T, 1 + D): time, then positions or poses; frames may move
    manifold
        space of all data, time included; that of the model is `manifold_with_derivatives` of it
    window
        number of samples of the parabolas that derivatives are taken from (`difference_weights`), also those of the
        frames; at most as many as there are

    Returns
    -------
    Demonstration
        over [time, point, velocity, acceleration]

    Raises
    ------
    ValueError
        for less than three samples and frames that change time
    """
    times, data = demonstration.times, demonstration.data
    space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold, data.shape[1])
    points = space.subset(range(1, space.dim))
    window = min(window, (len(data) - 1) // 2 * 2 + 1)
    velocities, accelerations = derivatives(times, data[:, 1:], points, window)
    first, _ = difference_weights(times, window)
    around = first[:, None] + np.arange(window)
    visible, frames = {}, {}
    for name, frame in without_time(demonstration.frames).items():
        seen = demonstration.is_visible(name)
        if frame.is_time_varying:
            visible[name] = seen[around].all(axis=1)
            frames[name] = _with_motion(frame, points, times, window).with_time()
        else:
            visible[name], frames[name] = seen, frame_with_derivatives(frame, points, orders=2).with_time()
    return Demonstration(times, np.column_stack([data, velocities, accelerations]), frames, visible)


def standing_frames(frames: Mapping[str, Frame], points: Manifold) -> dict[str, Frame]:
    """Frames for derivatives, as if the frames themselves stood still.

    Parameters
    ----------
    frames
        over [time, point], by name
    points
        manifold of the point

    Returns
    -------
    dict[str, Frame]
        over [time, point, velocity, acceleration], by name

    Raises
    ------
    ValueError
        for frames that vary with time or change it, and that do not fit the manifold of the points
    """
    moving = [name for name, frame in frames.items() if frame.is_time_varying]
    if moving:
        raise ValueError(f"the frames {moving} vary with time: choose one time step, with frame.at(t_index)")
    return frames_with_derivatives(frames, points, 2, keeps_time=True)


def _with_motion(frame: Frame, points: Manifold, times: Array, window: int) -> Frame:
    """The frame over [point, velocity, acceleration], moving as parabolas over windows of samples do; times (T,)."""
    standing = frame_with_derivatives(frame, points, orders=2)
    A, b = standing.A.copy(), standing.b.copy()
    (D, D_j), n = frame.A.shape[-2:], points.tangent_dim
    rows, flat = points.flat_ambient, points.flat_tangent
    columns, flat_columns = (rows, flat) if points.spheres else (np.arange(D_j), np.arange(D_j))
    block = frame.A[:, rows[:, None], columns]
    A_rate, A_rate_rate = (
        rate.reshape(block.shape)
        for rate in derivatives(times, block.reshape(len(times), -1), Manifold.euclidean(block[0].size), window)
    )
    A[:, (D + flat)[:, None], columns] = A_rate
    A[:, (D + n + flat)[:, None], columns] = A_rate_rate
    A[:, (D + n + flat)[:, None], D_j + flat_columns] = 2.0 * A_rate
    b[:, D + flat], b[:, D + n + flat] = derivatives(times, frame.b[:, rows], Manifold.euclidean(len(rows)), window)
    for s in points.spheres:
        omega, alpha = derivatives(times, frame.A[:, s.ambient, s.ambient][..., 3], Manifold.parse("S3"), window)
        velocity, acceleration = (slice(start + s.tangent.start, start + s.tangent.stop) for start in (D, D + n))
        b[:, velocity], b[:, acceleration] = omega, alpha
        R = A[:, velocity, velocity]
        A[:, acceleration, velocity] = np.cross(omega[:, :, None], R, axisa=1, axisb=1, axisc=1)
    if standing.inverse is None:
        return Frame(A, b)
    # That of block triangles, from that of the blocks on the diagonal
    below = standing.inverse @ (A - standing.A)
    return Frame(A, b, (np.eye(below.shape[-1]) - below + below @ below) @ standing.inverse)
