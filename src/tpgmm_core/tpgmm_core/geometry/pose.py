# SPDX-License-Identifier: Apache-2.0
"""Poses `[x, y, z, qx, qy, qz, qw]`, m, as elements of SE(3): shape (..., 7), batched over the leading axes.

What moves along a pose's axes is the manifold `POSE`: `exp` displaces and turns about the fixed axes, `log` is the
difference of two poses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE


def turned_covariance(covariance: Array, orientation: Array) -> Array:
    """Covariance of a pose about other fixed axes.

    Parameters
    ----------
    covariance
        (6, 6) of displacement and turn about the fixed axes of a frame, m² and rad²
    orientation
        of that frame, unit quaternion (4,)

    Returns
    -------
    Array
        (6, 6) about the axes in which the frame has that orientation
    """
    R = np.kron(np.eye(2), quaternion.rotation_matrix(orientation))
    turned: Array = R @ covariance @ R.T
    return turned


def compose(pose: ArrayLike, relative: ArrayLike) -> Array:
    """Place a pose that is given in the axes of another one.

    Parameters
    ----------
    pose : array_like, shape (..., 7)
        In the base frame.
    relative : array_like, shape (..., 7)
        In the axes of `pose`.

    Returns
    -------
    ndarray, shape (..., 7)
        `relative` in the base frame.
    """
    pose, relative = np.asarray(pose, dtype=float), np.asarray(relative, dtype=float)
    lever = quaternion.rotation_matrix(pose[..., 3:]) @ relative[..., :3, None]
    turn = quaternion.multiply(pose[..., 3:], relative[..., 3:])
    return np.concatenate([pose[..., :3] + lever[..., 0], turn], axis=-1)


def inverse(pose: ArrayLike) -> Array:
    """Give the pose of the base frame in the axes of a pose.

    Parameters
    ----------
    pose : array_like, shape (..., 7)
        In the base frame.

    Returns
    -------
    ndarray, shape (..., 7)
        `compose(pose, inverse(pose))` is the identity.
    """
    pose = np.asarray(pose, dtype=float)
    turn = quaternion.conjugate(pose[..., 3:])
    position = -quaternion.rotation_matrix(turn) @ pose[..., :3, None]
    return np.concatenate([position[..., 0], turn], axis=-1)


def pose_error(pose: ArrayLike, wanted: ArrayLike) -> tuple[float, float]:
    """Tell how far a pose is from another one.

    Parameters
    ----------
    pose, wanted : array_like, shape (7,)
        In the same frame; the sign of a quaternion does not matter.

    Returns
    -------
    distance : float
        Between the positions, m.
    angle : float
        Between the orientations, 0 to pi rad.
    """
    error = POSE.log(wanted, pose)
    return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
