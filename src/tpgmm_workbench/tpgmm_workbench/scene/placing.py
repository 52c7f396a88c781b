# SPDX-License-Identifier: Apache-2.0
"""Poses as viser takes them, and only where they have changed: what stands still costs a page nothing."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion

#: Smaller changes are not seen: of a position, m, and a quaternion; of a size, m.
SEEN, SIZE_SEEN = 2e-4, 1e-3


class Placed(Protocol):
    """A node of viser's scene."""

    position: Array
    wxyz: Array


def wxyz(q: Array) -> Array:
    """A quaternion x, y, z, w in viser's order."""
    return np.array([q[3], q[0], q[1], q[2]])


def pose_of(node: Placed) -> Array:
    """The pose (7,), m and unit quaternion x, y, z, w, of a node."""
    w, x, y, z = (float(value) for value in node.wxyz)
    return np.concatenate([np.asarray(node.position, dtype=float), quaternion.normalize([x, y, z, w])])


def place(node: Placed, pose: Array) -> bool:
    """Put a node at a pose (7,), where it is not there yet; whether it was moved."""
    moved = False
    if np.abs(np.asarray(node.position) - pose[:3]).max() > SEEN:
        node.position = np.array(pose[:3])
        moved = True
    turn = wxyz(pose[3:])
    if min(np.abs(node.wxyz - turn).max(), np.abs(node.wxyz + turn).max()) > SEEN:
        node.wxyz = turn
        moved = True
    return moved


def resize(node: Any, size: Array) -> None:
    """Give a node a size (3,), m, where it does not have it yet."""
    if np.abs(np.asarray(node.scale) - size).max() > SIZE_SEEN:
        node.scale = tuple(float(value) for value in size)
