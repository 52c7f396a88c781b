# SPDX-License-Identifier: Apache-2.0
"""Tables as demonstrations of a task: when the hand was where, and where the frames were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.conversion.columns import TIME_UNITS, columns_of, names_in, poses_of
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.tables import Table

FEWEST = 10
LONGEST_S, SLOWEST_S = 1e7, 1.0
"""No demonstration lasts longer; samples that are further apart are said."""
LEAP = 3.0
"""A step that is so many times as long as the longest of a movement is none of it."""
MOST_REPEATED = 3
"""Rows to a time: where there are more, times are rounded, and say too little."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Which columns are what.

    Attributes
    ----------
    movement
        of the hand
    time
        one column, or two of seconds and nanoseconds; None where `rate` tells
    rate
        samples per second, Hz; None where `time` tells
    frames, numbers
        name → columns of poses of frames, and of further numbers
    split
        column that changes where the next demonstration begins; None: there is one
    unit, time_unit, orientation
        see `columns`
    """

    movement: str
    time: str | None = None
    rate: float | None = None
    frames: Mapping[str, str] = field(default_factory=dict)
    numbers: Mapping[str, str] = field(default_factory=dict)
    split: str | None = None
    unit: str = "m"
    time_unit: str = "s"
    orientation: str = "xyzw"

    def arrays(self) -> set[str]:
        """Names of the arrays that are used."""
        texts = [self.movement, self.time, self.split, *self.frames.values(), *self.numbers.values()]
        return {name for text in texts if text is not None for name in names_in(text)}


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """One demonstration.

    Attributes
    ----------
    ns
        (T,) from the first sample
    movement
        (T, 7) poses, m
    frames
        name → (T, 7)
    numbers
        name → (T,)
    notes
        what was left out or taken for granted, in words
    """

    ns: np.ndarray[tuple[int], np.dtype[np.int64]]
    movement: Array
    frames: Mapping[str, Array]
    numbers: Mapping[str, Array]
    notes: tuple[str, ...] = ()


def demonstrations_of(table: Table, columns: Columns) -> list[Shown]:
    """Demonstrations of a table: one, or as many as a column tells apart.

    Parameters
    ----------
    table
        of a file
    columns
        which are what

    Returns
    -------
    list[Shown]
        rows of the movement that are not finite are left out; of frames they stay, and are not to be published

    Raises
    ------
    ConversionError
        columns are missing or do not fit together, or times do not increase.
    """
    raw = columns_of(table, columns.movement)
    padding = padded(raw)
    raw = np.where(padding[:, None], np.nan, raw)
    movement = poses_of(raw, columns.unit, columns.orientation)
    T = len(movement)
    notes = []
    if padding.any():
        notes.append(f"the last {padding.sum()} of {T} rows of the movement are 0, as where shorter ones are filled up")
    if movement.shape and (movement[:, 3:] == [0.0, 0.0, 0.0, 1.0]).all():
        notes.append("no orientation of the hand is given: 0 0 0 1 was written; what a model says of it means nothing")
    if columns.time is not None:
        times = _seconds(columns_of(table, columns.time), columns.time, columns.time_unit)
    else:
        assert columns.rate is not None
        times = np.arange(T) / columns.rate
    frames = {
        name: _as_long(poses_of(_row(columns_of(table, text), T), columns.unit, columns.orientation), T, name)
        for name, text in columns.frames.items()
    }
    numbers = {
        name: _as_long(_single(columns_of(table, text), text)[:, None], T, name)[:, 0]
        for name, text in columns.numbers.items()
    }
    if len(times) != T:
        raise ConversionError(f"has {len(times)} times and {T} samples of the movement; expected as many")
    cuts = [0, T]
    if columns.split is not None:
        labels = _as_long(_single(columns_of(table, columns.split), columns.split)[:, None], T, "split")[:, 0]
        cuts = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), T]
    found = []
    for first, last in zip(cuts, cuts[1:], strict=False):
        part = slice(first, last)
        finite = np.isfinite(times[part]) & np.isfinite(movement[part]).all(axis=1) & ~padding[part]
        at = np.arange(first, last)[finite]
        if len(at) < FEWEST:
            raise ConversionError(f"has {len(at)} samples from row {first} on, expected at least {FEWEST} finite ones")
        if abs(lasts := float(times[at[-1]] - times[at[0]])) > LONGEST_S:
            raise ConversionError(
                f"would last {lasts / 86400.0:.3g} days: its times are not in {columns.time_unit}; give their unit by "
                "--time-unit s, ms, us or ns, or name another column"
            )
        ns = np.round(1e9 * (times[at] - times[at[0]])).astype(np.int64)
        fresh = np.diff(ns, prepend=ns[0] - 1) != 0
        repeated = int((~fresh).sum())
        if len(ns) <= MOST_REPEATED * fresh.sum():
            at, ns = at[fresh], ns[fresh]
        if not (np.diff(ns) > 0).all():
            k = int(np.argmin(np.diff(ns) > 0))
            if (np.diff(ns) >= 0).all():
                raise ConversionError(
                    f"has {len(ns) / fresh.sum():.0f} rows to each time, which is rounded, as {times[at[k]]:g} s in "
                    f"row {at[k]} and the next one; name another column, or give --rate instead of --time"
                )
            raise ConversionError(
                f"has times that do not increase: {times[at[k]]:g} s in row {at[k]}, {times[at[k + 1]]:g} s in the "
                "next one; sort the rows, name another column, or --split where demonstrations lie one after the other"
            )
        left_out = int((~finite & ~padding[part]).sum())
        said = [f"{left_out} of {last - first} rows are not finite: left out"] if left_out else []
        said += [f"{repeated} of {last - first} rows repeat the time of the one before: left out"] if repeated else []
        if (period := 1e-9 * float(np.median(np.diff(ns)))) > SLOWEST_S:
            said.append(
                f"its samples are {period:.4g} s apart: if its times are not in {columns.time_unit}, give their "
                "unit by --time-unit"
            )
        seen = {name: _latest(poses, at, first) for name, poses in frames.items()}
        further = {name: _latest(values[:, None], at, first)[:, 0] for name, values in numbers.items()}
        for option, text, values in (
            *(("--frame", f"{name}={columns.frames[name]}", poses) for name, poses in seen.items()),
            *(("--number", f"{name}={columns.numbers[name]}", values[:, None]) for name, values in further.items()),
        ):
            if not np.isfinite(values).all(axis=1).any():
                raise ConversionError(
                    f"has nothing finite in {option} {text} from row {first} on: name other columns, or leave it out"
                )
        found.append(Shown(ns, movement[at], seen, further, (*notes, *said)))
    return found


def padded(values: Array) -> NDArray[np.bool_]:
    """(T,) which rows of columns (T, k) are zeros at the end, to which they leap: they fill an array up."""
    filled = np.flatnonzero((values != 0.0).any(axis=1))
    last = int(filled[-1]) if len(filled) else len(values) - 1
    ways = np.linalg.norm(np.diff(values[: last + 1], axis=0), axis=1)
    leap = float(np.linalg.norm(values[last])) > LEAP * np.nanmax(ways, initial=0.0)
    return np.asarray((np.arange(len(values)) > last) & leap)


def _latest(values: Array, at: NDArray[np.intp], first: int) -> Array:
    """What (T, k) holds at some rows (S,), or else in those that were left out before each, from the first row on.

    Programs that join topics of several rates to one table have a row for each message of each.
    """
    rows = np.where(np.isfinite(values).all(axis=1), np.arange(len(values)), -1)
    latest = np.maximum.accumulate(rows)[at]
    since = np.append(first - 1, at[:-1])
    return np.where((latest > since)[:, None], values[latest], np.nan)


def _seconds(numbers: Array, text: str, unit: str) -> Array:
    """Times (T,) s out of one column, or of two: seconds and nanoseconds, as stamps of ROS have them."""
    if numbers.shape[1] == 2 and unit == "s":
        return numbers[:, 0] - np.nanmin(numbers[:, 0], initial=np.inf) + 1e-9 * numbers[:, 1]
    return _single(numbers, text) * TIME_UNITS[unit]


def _single(numbers: Array, text: str) -> Array:
    if len(numbers) == 1:  # a row, as MATLAB has times
        return numbers[0]
    if numbers.shape[1] != 1:
        raise ConversionError(f"has {numbers.shape[1]} columns in {text!r}, expected one")
    return numbers[:, 0]


def _row(numbers: Array, T: int) -> Array:
    """A pose that is given once, as a list of numbers (k,), has its columns there."""
    return (
        numbers.T if numbers.shape[1] == 1 and len(numbers) in (2, 3, 6, 7, 12, 16) and len(numbers) != T else numbers
    )


def _as_long(values: Array, T: int, name: str) -> Array:
    """(T, k); what is given once holds all the time."""
    if len(values) == 1:
        return np.tile(values, (T, 1))
    if len(values) != T:
        raise ConversionError(f"has {len(values)} rows of {name}, and {T} of the movement; expected as many, or one")
    return values
