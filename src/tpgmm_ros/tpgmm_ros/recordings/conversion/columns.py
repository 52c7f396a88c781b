# SPDX-License-Identifier: Apache-2.0
"""Columns of tables as users name them, and poses out of them.

x,y,z,qx,qy,qz,qw    columns by name
poses                a whole array
s.Data[1:4]          some columns of an array; [2] is a single one, counted from 0
[1:8]                of a file without names
x [m],y [m]          what is no number is part of the name
"""

from __future__ import annotations

import re

import numpy as np

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.tables import MATRICES, Table

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ORIENTATIONS = ("xyzw", "wxyz", "rpy", "rotation_vector")
_ITEM = re.compile(r"([^\[\],]*)(?:\[(\d+)(?::(\d+))?\])?")
MOST_RAD = 4.0 * np.pi
"""Angles of a hand that are larger are in degrees."""
_SQUARE = 1e-3
"""How far a rotation matrix that people write down may be from one."""


def names_in(text: str) -> set[str]:
    """Names of the arrays in a text as above; what stands in brackets and is no number is part of the name."""
    items = [(item, _ITEM.fullmatch(item)) for item in text.split(",")]
    return {(item if found is None else found[1]).strip() for item, found in items}


def columns_of(table: Table, text: str) -> Array:
    """Columns that a text names.

    Parameters
    ----------
    table
        of one demonstration
    text
        names with commas between, as above

    Returns
    -------
    Array
        (T, k); arrays (k, T), as MATLAB has them, are turned where that makes them longer than wide

    Raises
    ------
    ConversionError
        there is no such column, or they have different lengths.
    """
    parts = []
    if "" in (items := [item.strip() for item in text.split(",")]) and len(items) > 1:
        raise ConversionError(f"has no column without a name: there is a comma too many in {shown(text)}")
    for item in text.split(","):
        if item.strip() in table:
            parts.append(_upright(table[item.strip()]))
            continue
        found = _ITEM.fullmatch(item.strip())
        name = "" if found is None else str(found[1]).strip()
        if found is None or name not in table:
            there = [f"{key or '(no name)'} {_upright(value).shape}" for key, value in table.items()]
            hint = "; name a column without a name by its number, such as [0:3]" if set(table) == {""} else ""
            raise ConversionError(f"has no column or array {shown(item.strip())}; there are {listed(there, 12)}{hint}")
        array = _upright(table[name])
        if found[2] is not None:
            first = int(found[2])
            last = first + 1 if found[3] is None else int(found[3])
            if not first < last <= array.shape[1]:
                raise ConversionError(
                    f"has no columns {shown(item.strip())}; {name or 'it'} has {array.shape[1]}, counted from 0, and "
                    "the last is not meant in [first:last]"
                )
            array = array[:, first:last]
        parts.append(array)
    lengths = {len(part) for part in parts}
    if len(lengths) > 1:
        raise ConversionError(f"has columns of different lengths in {shown(text)}: {listed(map(str, sorted(lengths)))}")
    return np.hstack(parts)


def _upright(array: Array) -> Array:
    """(T, k), samples first."""
    if array.ndim == 3 or array.shape in MATRICES:  # transforms
        return array.reshape(-1, array.shape[-2] * array.shape[-1])
    if array.ndim == 1:
        return array[:, None]
    return array.T if array.shape[0] < array.shape[1] and 1 < array.shape[0] <= 16 else array


def poses_of(numbers: Array, unit: str = "m", orientation: str = "xyzw") -> Array:
    """Poses out of columns.

    Parameters
    ----------
    numbers
        (T, 2) x, y; (T, 3) x, y, z; (T, 6) or (T, 7) these and an orientation; (T, 16) homogeneous transforms, written
        row by row or column by column, which the place of 0 0 0 1 tells; (T, 12) these row by row without 0 0 0 1
    unit
        of positions: m, cm, mm or in
    orientation
        xyzw, wxyz (quaternions), rpy (roll, pitch, yaw about fixed axes, rad) or rotation_vector (rad)

    Returns
    -------
    Array
        (T, 7) x, y, z in m, qx, qy, qz, qw; where there is no orientation it is 0 0 0 1

    Raises
    ------
    ConversionError
        so many columns are no pose, or a matrix is no rotation.
    """
    if numbers.shape[1] == 12:
        numbers = np.hstack([numbers, np.tile([0.0, 0.0, 0.0, 1.0], (len(numbers), 1))])
    T, count = numbers.shape
    poses = np.tile([0.0, 0.0, 0.0, *quaternion.IDENTITY], (T, 1))
    if count == 16:
        matrices = numbers.reshape(T, 4, 4)
        if (matrices[:, 3, :3] != 0.0).any() and (matrices[:, :3, 3] == 0.0).all():
            matrices = matrices.swapaxes(1, 2)  # written column by column
        R, finite = matrices[:, :3, :3].copy(), np.isfinite(matrices).all(axis=(1, 2))
        R[~finite] = np.eye(3)
        last = matrices[finite, 3]
        if (
            np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max(initial=0.0) > _SQUARE
            or (np.linalg.det(R) < 0.0).any()
            or not (last == [0.0, 0.0, 0.0, 1.0]).all()
        ):
            raise ConversionError("has 12 or 16 columns that are no rotation and translation with a row 0 0 0 1")
        U, _, Vt = np.linalg.svd(R)  # the nearest rotation: what people write down is rounded
        poses[:, :3], poses[:, 3:] = matrices[:, :3, 3], quaternion.from_matrix(U @ Vt)
    elif count in (2, 3):
        poses[:, :count] = numbers
    elif (count, orientation in ("rpy", "rotation_vector")) in ((6, True), (7, False)):
        poses[:, :3], turns = numbers[:, :3], numbers[:, 3:]
        poses[:, 3:] = _quaternions(turns, orientation)
    else:
        raise ConversionError(
            f"has {count} columns for a pose with the orientation {orientation}; expected 2 (x, y), 3 (x, y, z), 7 "
            "(and a quaternion), 12 or 16 (a transform) or, with --orientation rpy or rotation_vector, 6"
        )
    poses[:, :3] *= UNITS[unit]
    return poses


def _quaternions(turns: Array, orientation: str) -> Array:
    if orientation == "xyzw":
        return turns
    if orientation == "wxyz":
        return turns[:, [1, 2, 3, 0]]
    largest = float(np.nanmax(np.abs(turns), initial=0.0))
    if largest > MOST_RAD:
        raise ConversionError(
            f"has angles up to {largest:.4g}, which are {largest / (2.0 * np.pi):.0f} turns in rad: are they in "
            "degrees? Convert them to rad, and convert again"
        )
    if orientation == "rotation_vector":
        return quaternion.exp(turns)
    x, y, z = (quaternion.exp(np.outer(turns[:, k], np.eye(3)[k])) for k in range(3))
    return quaternion.multiply(z, quaternion.multiply(y, x))
