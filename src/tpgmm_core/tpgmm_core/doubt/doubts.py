# SPDX-License-Identifier: Apache-2.0
"""`Doubt`: one thing about a recording that makes no sense, what to do. `RawDemonstration`: what doubts are about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array

MOST_NAMES = 4
"""Recordings that a doubt names in its text."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """One thing that makes no sense.

    Attributes
    ----------
    kind
        what is doubted, one word for programs: clock, lag, gap, rate, units, origin, order, speed, duration, length,
        still, copy, misfit, transforms
    about
        names of the recordings that it is about; none where it is about all of them
    text
        what was found, where, and what to do
    refuses
        nothing can be learned from these recordings together; otherwise it is only said
    """

    kind: str
    about: tuple[str, ...]
    text: str
    refuses: bool = False

    def __str__(self) -> str:
        names = [one_line(name) for name in self.about[:MOST_NAMES]]
        if len(self.about) > MOST_NAMES:
            names.append(f"and {len(self.about) - MOST_NAMES} more")
        return f"{', '.join(names)}: {self.text}" if names else self.text


def evenly_chosen[T](several: Sequence[T], most: int) -> list[T]:
    """All of several things, or so many of them at even distances: what holds of all shows in some."""
    return [several[i] for i in np.unique(np.linspace(0, len(several) - 1, most).round().astype(int)).tolist()]


@dataclass(frozen=True, slots=True, eq=False)
class RawDemonstration:
    """A demonstration as it was recorded.

    Attributes
    ----------
    name
        of the recording
    times
        (T,) s from the first sample, increasing
    movement
        (T, 7) x, y, z in m, qx, qy, qz, qw, in the base frame
    frames
        name → (T, 7) of frames that were observed
    visible
        name → (T,) where they had been seen
    from_start
        whether the task sees the movement also from where it begins
    """

    name: str
    times: Array
    movement: Array
    frames: Mapping[str, Array] = field(default_factory=dict)
    visible: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    from_start: bool = False

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.times[-1] - self.times[0])

    @property
    def extent(self) -> float:
        """Diagonal of the box around the positions of the movement, m."""
        return float(np.linalg.norm(np.ptp(self.movement[:, :3], axis=0)))

    @property
    def length(self) -> float:
        """Length of the path, m; noise adds nothing, since it is that of a path of 50 straight pieces."""
        kept = np.unique(np.linspace(0, len(self.times) - 1, 51).round().astype(int))
        return float(np.linalg.norm(np.diff(self.movement[kept, :3], axis=0), axis=1).sum())

    def seen(self, frame: str) -> Array:
        """Poses (S, 7) of a frame at the samples at which it had been seen."""
        return self.frames[frame][self.visible[frame]] if frame in self.visible else self.frames[frame]
