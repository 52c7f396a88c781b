# SPDX-License-Identifier: Apache-2.0
"""`with_velocity`: demonstrations over [x, v], for models that `StableDynamics` retrieves from."""

from __future__ import annotations

import numpy as np

from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.retrieval.differences import derivatives
from tpgmm_core.retrieval.frame_derivatives import frame_with_derivatives
from tpgmm_core.retrieval.frames import without_time


def with_velocity(
    demonstration: Demonstration, manifold: str | Manifold = "euclidean", window: int = 9
) -> Demonstration:
    """The demonstration as [x, v] in place of [time, x], for an `EndpointTPGMM` that `StableDynamics` retrieves from.

    Data become (T, D + n), on the manifold of x and R^n: "R1 x R3 x S3" gives "R3 x S3 x R6". Velocities are per s, on
    S³ about the fixed axes; frames see them as vectors (`frame_with_derivatives`).

    Parameters
    ----------
    demonstration
        data (T, 1 + D): time, then positions or poses
    manifold
        space of all data, time included
    window
        number of samples of the parabolas that velocities are taken from; at most as many as there are

    Returns
    -------
    Demonstration
        over [x, v]

    Raises
    ------
    ValueError
        for less than three samples, and frames that change time or do not fit the manifold
    """
    space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold, demonstration.data.shape[1])
    points = space.subset(range(1, space.dim))
    times, x = demonstration.times, demonstration.data[:, 1:]
    velocity, _ = derivatives(times, x, points, min(window, (len(times) - 1) // 2 * 2 + 1))
    frames = {name: frame_with_derivatives(frame, points) for name, frame in without_time(demonstration.frames).items()}
    return Demonstration(times, np.column_stack([x, velocity]), frames, demonstration.visible)
