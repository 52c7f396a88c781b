# SPDX-License-Identifier: Apache-2.0
"""Where a long recording is to be cut into takes: at rests of the hand, or by a signal. Pure functions of numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion

CELLS = 20
"""Parts that a pause is looked at in: noise is averaged within each."""
ALIKE = 0.25
"""Places are alike where they differ by less than this share of the movements' extent."""

type Take = tuple[float, float]
"""First and last time, s."""


@dataclass(frozen=True, slots=True)
class Rest:
    """When a hand is at rest.

    Parameters
    ----------
    pause
        it stays for so long, s,
    way
        within a box of this diagonal, m,
    turn
        and turns by no more, rad
    """

    pause: float = 1.0
    way: float = 0.01
    turn: float = 0.05

    def __post_init__(self) -> None:
        for name in ("pause", "way", "turn"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected more than 0")


def takes_between_rests(times: Array, poses: Array, rest: Rest, shortest: float = 0.5) -> list[Take]:
    """The movements between rests of a hand.

    Half a pause of the rests at both sides belongs to a take, so that it begins and ends with the hand at rest: the
    last centimetre of a movement lies within what counts as rest.

    Parameters
    ----------
    times
        (T,) s, increasing
    poses
        (T, 7) x, y, z in m, qx, qy, qz, qw
    rest
        what rest is
    shortest
        movements that take less time, without the rests, are none, s

    Returns
    -------
    list[Take]
        one after the other; a single one, of all the time, where there is no rest
    """
    begin, end = float(times[0]), float(times[-1])
    step = rest.pause / CELLS
    at_rest = _cells_at_rest(_cells(times, poses, step), rest)
    found = []
    for first, last in _runs(~at_rest):
        if (last - first) * step < shortest and at_rest.any():
            continue
        before = begin + first * step - (0.5 * rest.pause if first else 0.0)
        found.append((before, min(end, begin + last * step + (0.5 * rest.pause if last < len(at_rest) else 0.0))))
    return found


def _cells(times: Array, poses: Array, step: float) -> Array:
    """Means (N, 7) of the poses in even parts of the time; where there are none, those of the part before."""
    at = np.floor((times - times[0]) / step).astype(np.intp)
    values = np.hstack([poses[:, :3], quaternion.continuous(poses[:, 3:])])
    counts = np.bincount(at)
    sums = np.stack([np.bincount(at, column) for column in values.T], axis=1)
    filled = np.maximum.accumulate(np.where(counts > 0, np.arange(len(counts)), 0))
    return np.asarray(sums[filled] / counts[filled, None])


def _cells_at_rest(cells: Array, rest: Rest) -> NDArray[np.bool_]:
    """(N,) which parts belong to a pause."""
    if len(cells) < CELLS:
        return np.zeros(len(cells), bool)
    windows = np.lib.stride_tricks.sliding_window_view(cells, CELLS, axis=0)
    spans = windows.max(axis=-1) - windows.min(axis=-1)
    # a turn by a small angle changes the quaternion by half of it
    calm = (np.linalg.norm(spans[:, :3], axis=1) <= rest.way) & (
        2.0 * np.linalg.norm(spans[:, 3:], axis=1) <= rest.turn
    )
    change = np.zeros(len(cells) + 1, int)
    change[: len(calm)] += calm
    change[CELLS:] -= calm
    return np.cumsum(change)[:-1] > 0


def takes_by_signal(
    times: Array,
    holds: NDArray[np.bool_],
    span: Take,
    until_next: bool = False,
    pause: float = 0.0,
    shortest: float = 0.5,
) -> list[Take]:
    """The takes that a signal tells of.

    Parameters
    ----------
    times
        (S,) when it was heard, s, never decreasing
    holds
        (S,) whether it held then; it stays so until the next time, and does not hold before the first
    span
        first and last time of the recording, s
    until_next
        a take lasts until the next one begins; otherwise, as long as the signal holds
    pause
        where it does not hold for less time than that, it counts as if it did, s
    shortest
        takes that last less are none, s

    Returns
    -------
    list[Take]
        one after the other
    """
    moments = np.append(times, max(span[1], float(times[-1])) if len(times) else span[1])
    while_it_holds: list[Take] = []
    for first, last in _runs(holds):
        begin, end = float(moments[first]), float(moments[last])
        if while_it_holds and begin - while_it_holds[-1][1] < pause:
            begin = while_it_holds.pop()[0]
        while_it_holds.append((begin, end))
    if until_next:
        begins = [begin for begin, _ in while_it_holds]
        while_it_holds = list(zip(begins, [*begins[1:], span[1]], strict=True))
    clipped = [(max(begin, span[0]), min(end, span[1])) for begin, end in while_it_holds]
    return [(begin, end) for begin, end in clipped if end - begin >= shortest]


def repeats_every(times: Array, poses: Array, takes: Sequence[Take]) -> int | None:
    """Whether takes show the same thing again and again.

    Parameters
    ----------
    times
        (T,) s, increasing
    poses
        (T, 7) of the hand
    takes
        of this recording

    Returns
    -------
    int or None
        1 where each take begins where the others do; 2 where every second one does, since those between lead the hand
        back; None where neither is so
    """
    parts = [poses[(times >= begin) & (times <= end), :3] for begin, end in takes]
    if len(parts) < 2 or not all(map(len, parts)):
        return None
    near = ALIKE * float(np.median([np.linalg.norm(np.ptp(part, axis=0)) for part in parts]))
    starts = np.array([part[0] for part in parts])
    if _are_alike(starts, near):
        return 1
    return 2 if len(parts) > 2 and _are_alike(starts[::2], near) else None


def _are_alike(places: Array, near: float) -> bool:
    return bool((np.linalg.norm(places - np.median(places, axis=0), axis=1) <= near).all())


def _runs(holds: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last + 1 of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
