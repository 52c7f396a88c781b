# SPDX-License-Identifier: Apache-2.0
"""Fields that messages share, read alike from those of rclpy and those that rosbags makes: no ROS is imported."""

from __future__ import annotations

from typing import Any

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import is_pose_covariance

Numbers = tuple[float, float, float, float, float, float, float]


def time_to_ns(stamp: Any) -> int:
    """A stamp in ns: see `nanoseconds`."""
    return nanoseconds(stamp.sec, stamp.nanosec)


def nanoseconds(sec: int, nanosec: int) -> int:
    """A time in ns. More nanoseconds than a second has are none: it is taken for the end of its second."""
    return int(sec * 1_000_000_000 + min(nanosec, 999_999_999))


def pose_numbers(pose: Any) -> Numbers:
    """The seven numbers of a Pose, as they came, not checked."""
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def transform_numbers(transform: Any) -> Numbers:
    """The seven numbers of a Transform, as they came, not checked."""
    p, q = transform.translation, transform.rotation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def pose_to_array(pose: Any) -> Array:
    """(7,): a Pose as it came, not checked."""
    return np.array(pose_numbers(pose))


#: Variances beyond this say nothing more, m² and rad².
LARGEST_VARIANCE = 1e9


def covariance_array(pose: Any) -> Array | None:
    """(6, 6) of a PoseWithCovariance; None where it is all zero, or no covariance: the publisher knows none.

    What is larger than `LARGEST_VARIANCE` is scaled down to it.

    Parameters
    ----------
    pose
        a geometry_msgs/PoseWithCovariance

    Returns
    -------
    Array or None
        m² and rad², symmetric and with no negative eigenvalue
    """
    covariance = np.array(pose.covariance, dtype=np.float64).reshape(6, 6)
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).all():
        return None
    covariance /= max(1.0, float(np.abs(covariance).max()) / LARGEST_VARIANCE)
    return covariance if is_pose_covariance(covariance) else None
