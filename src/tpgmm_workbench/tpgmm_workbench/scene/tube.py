# SPDX-License-Identifier: Apache-2.0
"""A tube of covariance along a path: around each point the ellipse of two standard deviations across the way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array

#: Corners of each ellipse.
SIDES = 12
#: A tube is never thinner than this, so that it is seen, nor wider, so that what is beside it is seen, m.
THINNEST, WIDEST = 0.002, 0.15


def tube(path: Array, covariances: Array, deviations: float = 2.0) -> tuple[Array, NDArray[np.int64]]:
    """The surface of a tube around a path.

    Parameters
    ----------
    path
        (N, 3), m, at least two points
    covariances
        (N, 3, 3), m^2
    deviations
        standard deviations to each side

    Returns
    -------
    tuple[Array, NDArray[np.int64]]
        vertices (N * SIDES, 3) and faces of it

    Raises
    ------
    ValueError
        for fewer than two points, or other shapes
    """
    if path.ndim != 2 or path.shape[1] != 3 or len(path) < 2 or covariances.shape != (len(path), 3, 3):
        raise ValueError(
            f"a tube needs a path (N, 3) of two points or more with covariances (N, 3, 3); got {path.shape} and "
            f"{covariances.shape}"
        )
    across = np.stack(_across(path), axis=2)  # (N, 3, 2)
    values, vectors = np.linalg.eigh(across.transpose(0, 2, 1) @ covariances @ across)
    radii = np.clip(deviations * np.sqrt(np.maximum(values, 0.0)), THINNEST, WIDEST)
    axes = across @ vectors * radii[:, None, :]
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    # the same corner of each ellipse lies in the same direction, so that the surface is not wrung
    ways = vectors.transpose(0, 2, 1) @ np.stack([np.cos(angles), np.sin(angles)])  # (N, 2, SIDES)
    vertices = path[:, None] + (axes @ ways).transpose(0, 2, 1)
    ring, corner = np.meshgrid(np.arange(len(path) - 1), np.arange(SIDES), indexing="ij")
    here, beside = ring * SIDES + corner, ring * SIDES + (corner + 1) % SIDES
    faces = np.stack([[here, beside, here + SIDES], [beside, beside + SIDES, here + SIDES]])
    return vertices.reshape(-1, 3), faces.transpose(0, 2, 3, 1).reshape(-1, 3)


def _across(path: Array) -> tuple[Array, Array]:
    """Two unit vectors (N, 3) across the path at each point, which turn as little as possible along it."""
    along = np.gradient(path, axis=0)
    length = np.linalg.norm(along, axis=1)
    first, second = np.empty_like(path), np.empty_like(path)
    way = np.array([0.0, 0.0, 1.0])
    side = np.array([1.0, 0.0, 0.0])
    for i in range(len(path)):
        if length[i] > 1e-9:  # a path that rests goes on as before
            way = along[i] / length[i]
        side = side - way * (way @ side)
        size = float(np.linalg.norm(side))
        if size < 1e-6:
            side = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
            size = float(np.linalg.norm(side))
        side = side / size
        first[i], second[i] = side, np.cross(way, side)
    return first, second
