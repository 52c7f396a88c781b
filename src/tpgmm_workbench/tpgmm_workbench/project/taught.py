# SPDX-License-Identifier: Apache-2.0
"""`TaughtDemonstration`: one demonstration of a project, what was noted about it, and its paths for drawing."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_ros.recordings.bags import MIN_SAMPLES
from tpgmm_ros.recordings.recording import Recording
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.notes import Notes

NOTES = "notes.json"


@dataclass(frozen=True, slots=True, eq=False)
class TaughtDemonstration:
    """One demonstration.

    Parameters
    ----------
    number
        from 1, in the order of teaching; never given again
    path
        of its bag
    notes
        comment, trim, whether it is used
    whole
        what the bag holds of the task, untrimmed; None where it cannot be read
    problem
        why it cannot be read; else empty
    """

    number: int
    path: Path
    notes: Notes = field(default_factory=Notes)
    whole: Recording | None = None
    problem: str = ""

    @property
    def is_used(self) -> bool:
        """Whether models learn from it."""
        return self.notes.is_used and not self.notes.is_undone and self.whole is not None

    @property
    def recording(self) -> Recording:
        """What is used of it: trimmed, as the notes say. Raises ProjectError where the bag cannot be read."""
        if self.whole is None:
            raise ProjectError(f"demonstration {self.number} cannot be read: {self.problem}")
        return self.whole if self.notes.trim is None else trimmed(self.whole, *self.notes.trim)

    @property
    def situation(self) -> dict[str, Array]:
        """Where the frames were when they were first seen: name -> pose (7,) in the base frame."""
        recording = self.recording
        first = {name: np.flatnonzero(recording.visible[name]) for name in recording.frames}
        return {name: recording.frames[name][at[0]] for name, at in first.items() if len(at)}

    def path_in(self, frame: str | None = None, count: int = 200) -> Array:
        """The path of the hand, for drawing.

        Parameters
        ----------
        frame
            that it is seen from; None: the base frame
        count
            most poses

        Returns
        -------
        Array
            poses (T, 7)

        Raises
        ------
        ProjectError
            for a frame that the task has not got, and a bag that cannot be read
        """
        recording = self.recording
        at = np.unique(np.linspace(0, len(recording.times) - 1, count).round().astype(int))
        movement = recording.movement[at]
        if frame is None:
            return movement
        if frame not in recording.frames:
            raise ProjectError(f"there is no frame {frame!r}; there are {', '.join(recording.frames)}")
        return compose(inverse(recording.frames[frame][at]), movement)


def trimmed(recording: Recording, begin: float, end: float) -> Recording:
    """The part of a recording between two times.

    Parameters
    ----------
    recording
        untrimmed
    begin, end
        s from its first sample

    Returns
    -------
    Recording
        its times begin at 0

    Raises
    ------
    ProjectError
        where too little is left
    """
    kept = np.flatnonzero((recording.times >= begin) & (recording.times <= end))
    if len(kept) < MIN_SAMPLES:
        raise ProjectError(
            f"between {begin:.2f} and {end:.2f} s are {len(kept)} samples of {recording.name}, which lasts "
            f"{recording.duration:.2f} s; expected at least {MIN_SAMPLES}: trim less"
        )
    return recording.at(kept)
