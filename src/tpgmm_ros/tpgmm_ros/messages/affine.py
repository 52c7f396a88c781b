# SPDX-License-Identifier: Apache-2.0
"""Affine maps that others publish as `tpgmm_msgs/TaskFrame`: observed as a pose, and what its axes do to positions.

Read alike from the messages of rclpy and those that rosbags makes: no ROS is imported.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.poses import MAX_NUMBER, Observation
from tpgmm_ros.messages.fields import covariance_of

ROUNDING = 1e-6
"""How far what people compute of a quaternion is off, at most."""


def affine_observation(stamp_ns: int, frame_id: str, item: Any) -> Observation:
    """What a TaskFrame says.

    Parameters
    ----------
    stamp_ns
        when it was true, ns
    frame_id
        the frame that it is expressed in
    item
        the message. A map of positions alone, 3 x 3, leaves orientations as they are. One of poses, 7 x 7, is
        blkdiag(A, L(q)) and b = [p, 0], as in `Frame.from_pose`, with any A (3, 3)

    Returns
    -------
    Observation
        with the pose (p, q) and the stretch R(q)^T A; or with a fault
    """
    rows, cols = item.rows, item.cols
    if (rows, cols) not in ((3, 3), (7, 7)) or len(item.a) != rows * cols or len(item.b) != rows:
        found = f"{rows} x {cols}, with {len(item.a)} numbers in a and {len(item.b)} in b"
        return _no_map(stamp_ns, frame_id, f"{found}; expected 3 x 3 (positions) or 7 x 7 (poses), and all numbers")
    A, b, q = np.array(item.a, float).reshape(rows, cols), np.array(item.b, float), quaternion.IDENTITY
    if not (np.abs(A).max() <= MAX_NUMBER and np.abs(b).max() <= MAX_NUMBER):  # nor numbers that are none
        # refused, and in bags left out, as a pose that is not finite
        return Observation(stamp_ns, frame_id, np.full(7, np.nan), stretch=np.full((3, 3), np.nan))
    if rows == 7:
        q = A[3:, 6]  # L(q) e_w
        rest = A[:3, 3:], A[3:, :3], A[3:, 3:] - quaternion.left_matrix(q), b[3:], q @ q - 1.0
        if np.abs(np.concatenate([np.ravel(part) for part in rest])).max() > ROUNDING:
            what = "its last four rows and columns are no left multiplication L(q) by a unit quaternion, beside zeros"
            return _no_map(stamp_ns, frame_id, what)
    stretch = quaternion.rotation_matrix(q).T @ A[:3, :3]
    covariance = covariance_of(item.pose_covariance)
    return Observation(stamp_ns, frame_id, np.concatenate([b[:3], q]), covariance, stretch)


def _no_map(stamp_ns: int, frame_id: str, what: str) -> Observation:
    return Observation(stamp_ns, frame_id, np.full(7, np.nan), fault=f"no map of poses: {what}")
