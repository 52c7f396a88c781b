# SPDX-License-Identifier: Apache-2.0
"""What makes a pose of a frame out of an observation: one rule, for topics and for recordings.

An observation is used where it is in the base frame and is a pose. Frame ids may have the leading slash of ROS 1. A
quaternion may have half or twice the length of one: it is scaled, and lengths that are no rounding are said. Others
are no quaternions, but angles or a rotation vector, say. Said are also positions whose magnitude looks like
millimetres: large numbers are no fault where the base is a map.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion

#: Largest number of a pose: beyond the size of the Earth, m, and any length of a quaternion.
MAX_NUMBER = 1e8
#: A quaternion that is shorter was never filled in.
SHORTEST = 1e-3
#: Four numbers whose length is not between these are no rotation: angles, say.
LEAST_LENGTH, MOST_LENGTH = 0.5, 2.0
#: A pose without any number in it, and others farther away than this, m: its message was never filled in.
UNFILLED_WAY = 0.1
#: Lengths of quaternions further from 1 are no rounding, and are said.
ROUNDING = 0.1
#: No arm reaches things that are farther away, m: millimetres, or a far origin.
FAR = 20.0

_SMALLEST = float(np.finfo(np.float64).tiny)
_KINDS = ("", "not finite", "implausibly large", "not written as floats", "zero quaternion", "no quaternion")


class Observation(NamedTuple):
    """What one message says of where one thing was.

    Parameters
    ----------
    stamp_ns
        when it was seen, ns
    frame_id
        the frame that the pose is expressed in
    pose
        ``[x, y, z, qx, qy, qz, qw]`` as it came, not checked
    covariance
        (6, 6) of position and turn about the fixed axes, m² and rad², as it came; None where none was given
    stretch
        (3, 3), what the thing's axes do to positions, where it says more than a pose; see `Frame.from_pose`
    fault
        why it says nothing: kind, ":", details; empty where it does
    lasts
        whether it was said once, by somebody who keeps it for those who come later: its stamp may be as old as it likes
    """

    stamp_ns: int
    frame_id: str
    pose: Sequence[float] | Array
    covariance: Array | None = None
    stretch: Array | None = None
    fault: str = ""
    lasts: bool = False


class CheckedPoses(NamedTuple):
    """Poses of a recording, judged.

    Parameters
    ----------
    poses
        (T, 7), those that are good with unit quaternions of continuous sign
    good
        (T,) which of them are poses
    reasons
        for each kind of fault: how many, and the first one, its number and its fault in words
    """

    poses: Array
    good: NDArray[np.bool_]
    reasons: dict[str, tuple[int, str]]


def wrong_frame(frame_id: str, base_frame: str) -> str:
    """Why poses in this frame are not poses in the base frame: kind, ":", details; empty where they are.

    Parameters
    ----------
    frame_id
        of a message
    base_frame
        the frame that is expected

    Returns
    -------
    str
        the reason, or nothing
    """
    if frame_id == base_frame or frame_id.removeprefix("/") == base_frame.removeprefix("/"):
        return ""
    remedy = "transform poses before they are published, or publish the transform on /tf"
    if not frame_id:
        remedy = "set frame_id where they are published"
    return f"wrong frame_id: {shown(frame_id)}, expected {shown(base_frame)}; {remedy}"


def check_pose(pose: ArrayLike) -> tuple[Array | None, str]:
    """The pose with its quaternion at unit length, or None and the reason why it is no pose.

    Parameters
    ----------
    pose
        ``[x, y, z, qx, qy, qz, qw]``

    Returns
    -------
    tuple[Array | None, str]
        the pose (7,) and an empty text, or None and the reason: its kind, ":", and the details
    """
    checked = np.array(pose, dtype=np.float64)
    if checked.shape != (7,):
        return None, f"wrong size: shape {checked.shape}, expected 7 numbers x y z qx qy qz qw"
    if not _is_faultless(checked) and (code := int(_faults(checked[None])[0])):
        return None, _words(code, checked)
    checked[3:] /= float(np.linalg.norm(checked[3:]))
    return checked, ""


def check_poses(poses: ArrayLike) -> CheckedPoses:
    """Judge many poses as `check_pose` does each of them.

    Parameters
    ----------
    poses
        (T, 7)

    Returns
    -------
    CheckedPoses
        the same poses, and which of them are good
    """
    checked = np.array(poses, dtype=np.float64).reshape(-1, 7)
    codes = _faults(checked)
    good = codes == 0
    reasons = {}
    for code in np.unique(codes[~good]).tolist():
        first = int(np.argmax(codes == code))
        reasons[_KINDS[code]] = int(np.count_nonzero(codes == code)), f"number {first}: {_words(code, checked[first])}"
    if good.any():
        checked[good, 3:] = quaternion.continuous(quaternion.normalize(checked[good, 3:]))
    return CheckedPoses(checked, good, reasons)


def never_filled(poses: Array) -> NDArray[np.bool_]:
    """Which poses (T, 7) of a recording have the position of an empty message, number by number, unlike the others.

    A movement may begin at the origin: then it is near there afterwards.

    Parameters
    ----------
    poses
        as they came, or with unit quaternions

    Returns
    -------
    NDArray[np.bool_]
        (T,)
    """
    empty = (poses[:, :3] == 0.0).all(axis=1)
    if not empty.any() or empty.all():
        return np.zeros(len(poses), np.bool_)
    nearest = np.nanmin(np.append(np.linalg.norm(poses[~empty, :3], axis=1), np.inf))
    return empty if nearest > UNFILLED_WAY else np.zeros(len(poses), np.bool_)


def odd_length(pose: Sequence[float] | Array) -> bool:
    """Whether the quaternion of a pose (7,), as it came, has a length that is no rounding."""
    _, _, _, x, y, z, w = pose
    square = x * x + y * y + z * z + w * w
    return not (1.0 - ROUNDING) ** 2 <= square <= (1.0 + ROUNDING) ** 2


def doubtful_units(positions: ArrayLike) -> str:
    """What is to be said of the magnitude of positions (T, 3) or (3,), m; empty where it is that of things in reach."""
    points = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
    away = float(np.median(np.linalg.norm(points, axis=1))) if len(points) else 0.0
    if away <= FAR:
        return ""
    what = "millimetres or another unit instead of metres, or a far origin"
    return f"lies {away:.4g} m from the origin of the base frame: {what}"


def _is_faultless(pose: Array) -> bool:
    """Whether one pose (7,) has none of the faults, faster than `_faults`, which says what others have."""
    values = pose.tolist()
    for value in values:
        if not (value == 0.0 or _SMALLEST <= abs(value) <= MAX_NUMBER):
            return False
    x, y, z, w = values[3:]
    return bool(LEAST_LENGTH**2 <= x * x + y * y + z * z + w * w <= MOST_LENGTH**2)


def _faults(poses: Array) -> NDArray[np.intp]:
    """For each pose (T, 7) the first of `_KINDS` that it has; 0 for none."""
    sizes = np.abs(poses)
    largest = sizes.max(axis=1)
    finite = largest < np.inf  # not a number is not below anything
    # rclpy copies the bits of a Python int into a float field, without an error
    bits = ((sizes < _SMALLEST) & (sizes != 0.0)).any(axis=1)
    x, y, z, w = np.where((largest <= MAX_NUMBER)[:, None], poses[:, 3:], 1.0).T
    square = x * x + y * y + z * z + w * w
    short, other = square < SHORTEST**2, (square < LEAST_LENGTH**2) | (square > MOST_LENGTH**2)
    return np.select([~finite, largest > MAX_NUMBER, bits, short, other], [1, 2, 3, 4, 5], 0)


def _words(code: int, pose: Array) -> str:
    found: object = pose.tolist()
    if code == 1:
        return f"{_KINDS[code]}: {found}"
    if code == 2:  # squares of larger numbers are not finite, and no camera sees so far
        return f"{_KINDS[code]}: {found}, expected numbers up to {MAX_NUMBER:g} (m)"
    if code == 3:
        return f"{_KINDS[code]}: {found}; an integer in a float field looks like this; write 1.0, not 1"
    length = float(np.linalg.norm(pose[3:]))
    hint = "" if code == 4 else "; angles or a rotation vector must be converted before they are published"
    return f"{_KINDS[code]}: {pose[3:].tolist()} has length {length:.3g}, expected 1{hint}"
