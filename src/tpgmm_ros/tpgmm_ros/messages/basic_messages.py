# SPDX-License-Identifier: Apache-2.0
"""Times, headers, poses and wrenches as messages and back, and the error of messages that are refused."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time as TimeMessage
from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped, WrenchStamped
from std_msgs.msg import Header

from tpgmm_core import Gaussian
from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_ros.messages.fields import pose_to_array, time_to_ns

__all__ = [
    "MAX_WRENCH",
    "MessageError",
    "floats",
    "header_at",
    "pose_from_array",
    "pose_stamped",
    "pose_to_array",
    "pose_with_covariance",
    "time_from_ns",
    "time_to_ns",
    "wrench_from_array",
    "wrench_to_array",
]

#: N and N m: the weight of a ton.
MAX_WRENCH = 1e4


class MessageError(ValueError):
    """A message is not what its type and topic promise."""


def floats(values: Array) -> array[float]:
    """What a ``float64[]`` field takes fastest: going through bytes, no number becomes a Python object."""
    return array("d", np.asarray(values, dtype=np.float64).tobytes())


def time_from_ns(nanoseconds: int) -> TimeMessage:
    """A time as a message."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return TimeMessage(sec=seconds, nanosec=rest)


def header_at(nanoseconds: int, frame_id: str) -> Header:
    """A header with a stamp, ns, and a frame."""
    return Header(stamp=time_from_ns(nanoseconds), frame_id=frame_id)


def pose_from_array(pose: Sequence[float] | Array) -> Pose:
    """A pose (7,), m and unit quaternion, as a message."""
    message = Pose()
    message.position.x, message.position.y, message.position.z = (float(value) for value in pose[:3])
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = (float(value) for value in pose[3:])
    return message


def pose_stamped(pose: Sequence[float] | Array, nanoseconds: int, frame_id: str) -> PoseStamped:
    """A pose with its stamp.

    Parameters
    ----------
    pose
        x, y, z in m, qx, qy, qz, qw
    nanoseconds
        stamp, ns
    frame_id
        the frame that it is expressed in

    Returns
    -------
    PoseStamped
        the message
    """
    return PoseStamped(header=header_at(nanoseconds, frame_id), pose=pose_from_array(pose))


def pose_with_covariance(gaussian: Gaussian, nanoseconds: int, frame_id: str) -> PoseWithCovarianceStamped:
    """A Gaussian over a pose; its tangent coordinates are already those of PoseWithCovariance.

    Parameters
    ----------
    gaussian
        over a pose
    nanoseconds
        stamp, ns
    frame_id
        the frame that it is expressed in

    Returns
    -------
    PoseWithCovarianceStamped
        the message
    """
    message = PoseWithCovarianceStamped(header=header_at(nanoseconds, frame_id))
    message.pose.pose = pose_from_array(gaussian.mean)
    message.pose.covariance = np.ascontiguousarray(gaussian.covariance).ravel()
    return message


def wrench_to_array(message: WrenchStamped) -> Array:
    """Force and torque of a message.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    Array
        shape (6,): force in N, torque in N m

    Raises
    ------
    MessageError
        not finite, or more than any robot stands.
    """
    force, torque = message.wrench.force, message.wrench.torque
    wrench = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
    if not np.isfinite(wrench).all():
        raise MessageError(f"wrench on {shown(message.header.frame_id)} is not finite: {wrench.tolist()}")
    if np.abs(wrench).max() > MAX_WRENCH:
        raise MessageError(f"a wrench is implausibly large: {wrench.tolist()}; expected {MAX_WRENCH:g} N, N m at most")
    return wrench


def wrench_from_array(wrench: Sequence[float] | Array, nanoseconds: int, link: str) -> WrenchStamped:
    """A wrench on a link, with its stamp.

    Parameters
    ----------
    wrench
        six numbers: force in N, torque in N m
    nanoseconds
        stamp, ns
    link
        name of the link's frame

    Returns
    -------
    WrenchStamped
        the message
    """
    message = WrenchStamped(header=header_at(nanoseconds, link))
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = (float(value) for value in wrench)
    return message
