# SPDX-License-Identifier: Apache-2.0
"""Fields that messages share, read alike from those of rclpy and those that rosbags makes: no ROS is imported."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import is_pose_covariance

_PART = re.compile(r"(\w+)(?:\[([^\[\]]+)\])?")

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
    """(6, 6) of a PoseWithCovariance: see `covariance_of`."""
    return covariance_of(pose.covariance)


def covariance_of(numbers: Any) -> Array | None:
    """(6, 6) of the numbers of a message; None where the publisher knows none: all zero, or -1 first, or not 36.

    One that is no covariance is all NaN, so that this can be said. What is larger than `LARGEST_VARIANCE` is scaled
    down to it.

    Parameters
    ----------
    numbers
        36, as in geometry_msgs/PoseWithCovariance; or none

    Returns
    -------
    Array or None
        m² and rad², symmetric and with no negative eigenvalue, or NaN
    """
    covariance = np.array(numbers, dtype=np.float64)
    if len(covariance) != 36:
        return None
    covariance = covariance.reshape(6, 6)
    if covariance[0, 0] == -1.0 or not covariance.any():  # -1: as sensor_msgs/Imu says that nothing is known
        return None
    if np.isfinite(covariance).all() and (np.diag(covariance) > 0.0).all():
        covariance /= max(1.0, float(np.abs(covariance).max()) / LARGEST_VARIANCE)
        if is_pose_covariance(covariance):
            return covariance
    return np.full((6, 6), np.nan)


def field_parts(field: str) -> list[tuple[str, str | None]]:
    """The names of a field such as "a.b[3]", each with its element."""
    return [(found[1], found[2]) for found in map(_PART.fullmatch, field.split(".")) if found is not None]


def number_of(message: Any, parts: list[tuple[str, str | None]]) -> float | None:
    """A number of a message of any type.

    Parameters
    ----------
    message
        the message
    parts
        of `field_parts`; ``[3]`` takes an element, ``[finger]`` that whose name stands in `name` beside the list

    Returns
    -------
    float or None
        None where there is no such element

    Raises
    ------
    TypeError
        messages of this type have no such number.
    """
    value = message
    for name, element in parts:
        holder, known = value, _field_names(value)
        if name not in known:
            there = listed(known) if known else "none: it is a value"
            raise TypeError(f"there is no field {name!r}; its fields are {there}")
        value = getattr(holder, name)
        if element is None:
            continue
        if not hasattr(value, "__len__") or isinstance(value, str):
            raise TypeError(f"{name!r} is no list, so that it has no [{element}]")
        names = list(getattr(holder, "name", ()))
        at = int(element) if element.isdecimal() else names.index(element) if element in names else len(value)
        if at >= len(value):
            return None
        value = value[at]
    if not isinstance(value, bool | int | float | np.number | np.bool_):
        is_list = hasattr(value, "__len__")
        what = "a list: name one of its elements, such as [0]" if is_list else "made of other fields"
        what = "a text" if isinstance(value, str) else what
        raise TypeError(f"it is {what}")
    return float(value)


def _field_names(value: Any) -> list[str]:
    if is_dataclass(value):
        return [item.name for item in fields(value) if not item.name.startswith("__")]
    return list(value.get_fields_and_field_types()) if hasattr(value, "get_fields_and_field_types") else []
