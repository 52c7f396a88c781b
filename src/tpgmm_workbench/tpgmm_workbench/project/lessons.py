# SPDX-License-Identifier: Apache-2.0
"""What models learn from: demonstrations as they were shown, moved by the corrections that came after them.

A correction says that the hand is to go elsewhere than before, for a part of the movement. Learned beside the others as
one demonstration more, it is outvoted: of m demonstrations that showed the old way and k that show the new one, the
mean moves by k / (m + k) of the way, and the covariance grows in just that frame, so that other frames count more. This
is so for learning from all at once as for `OnlineTPGMM`. And outside the corrected part the hand did what the model
wanted, so that it says nothing there, but that the model is right. So the demonstrations themselves are moved. What a
correction differs by from what the model did, seen from one frame j, is

    d(s) = log(x_j(s), y_j(s))   at each share s of the movement, with x the reference and y the hand,

faded in and out at its ends; each demonstration, seen from its own frame j, is moved by d(s). The covariances stay what
they were: how exactly the hand is to be there did not change. The n-th correction of the same part in the same frame
counts 1 / n, so that corrections are averaged and not added up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core import LearnedMixture
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_ros.recordings.recording import Recording
from tpgmm_workbench.project.notes import Correction
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.taught import TaughtDemonstration

SHARES = 101
FADES = 0.04
"""Share of the movement in which a correction comes and goes."""
STRAIGHT_M = 0.002
"""Demonstrations agree no better than this in any frame: hands and cameras are not more exact."""


@dataclass(frozen=True, slots=True, eq=False)
class Shift:
    """By how much a correction moves the movement, as one frame sees it.

    Parameters
    ----------
    correction
        where in the movement, in which frame
    steps
        (SHARES, 6) at even shares of the movement: place, m, and turn about the fixed axes, rad, in the frame's axes
    """

    correction: Correction
    steps: Array

    def moved(self, recording: Recording, gain: float = 1.0) -> Recording:
        """A recording moved by a share of it."""
        shares = recording.times / recording.duration
        grid = np.linspace(0.0, 1.0, SHARES)
        steps = gain * np.column_stack([np.interp(shares, grid, column) for column in self.steps.T])
        frame = recording.frames[self.correction.frame]
        return replace(recording, movement=compose(frame, POSE.exp(compose(inverse(frame), recording.movement), steps)))

    def overlaps(self, other: Shift) -> bool:
        """Whether both are about the same part, in the same frame."""
        mine, its = self.correction, other.correction
        return mine.frame == its.frame and min(mine.end, its.end) > max(mine.begin, its.begin)


def lessons_of(project: Project, shown: Sequence[TaughtDemonstration]) -> dict[int, Recording]:
    """Recordings that models are to learn from.

    Parameters
    ----------
    project
        whose models the corrections are about
    shown
        demonstrations and corrections, in the order of teaching

    Returns
    -------
    dict[int, Recording]
        by the numbers of demonstrations, each moved by the corrections
    """
    lessons = {one.number: one.recording for one in shown if one.notes.correction is None}
    models = {model.number: model for model in project.models()}
    shifts: list[Shift] = []
    for one in shown:
        correction = one.notes.correction
        if correction is not None and correction.model in models:
            shift = shift_of(project.load(models[correction.model]), one.recording, correction)
            gain = 1.0 / (1 + sum(shift.overlaps(other) for other in shifts))
            lessons = {number: shift.moved(recording, gain) for number, recording in lessons.items()}
            shifts.append(shift)
    return lessons


def shift_of(model: LearnedMixture, recording: Recording, correction: Correction) -> Shift:
    """What a correction changes.

    Parameters
    ----------
    model
        that ran
    recording
        what the hand did
    correction
        where in the movement, and in which frame

    Returns
    -------
    Shift
        what the hand was off elsewhere, since it lags and gives way, is left out: nobody meant that
    """
    reference = reproduce(model, recording.to_demonstration(float(model.metadata_["duration_s"])))
    shares = recording.times / recording.duration
    frame = recording.frames[correction.frame]
    steps = POSE.log(compose(inverse(frame), reference), compose(inverse(frame), recording.movement))
    steps = steps * fade(shares, correction.begin, correction.end)[:, None]
    grid = np.linspace(0.0, 1.0, SHARES)
    return Shift(correction, np.column_stack([np.interp(grid, shares, column) for column in steps.T]))


def fade(shares: Array, begin: float, end: float) -> Array:
    """Weights that are 1 in a part of the movement, and fall to 0 within FADES before and after it, without a corner.

    Parameters
    ----------
    shares
        (T,) of the movement
    begin, end
        of the part

    Returns
    -------
    Array
        (T,) from 0 to 1
    """
    outside = np.maximum(np.maximum(begin - shares, shares - end), 0.0) / FADES
    return smoothstep(np.clip(1.0 - outside, 0.0, 1.0))


def frame_of(
    lessons: Sequence[Recording], corrections: Sequence[Recording], begin: float, end: float, names: Sequence[str]
) -> str:
    """The frame that a correction is most likely about: the one that sees the hand at the same place there.

    Parameters
    ----------
    lessons
        demonstrations before the corrections
    corrections
        of this part, the new one too; from two on they tell as much as demonstrations do
    begin, end
        shares of the movement
    names
        of the frames to choose from

    Returns
    -------
    str
        its name
    """
    spread = {}
    for name in names:
        squares, freedom = 0.0, 0
        for group in (lessons, corrections):
            if len(group) < 2:
                continue
            places = np.array([_seen(one, name, begin, end) for one in group])
            squares += float(np.sum((places - places.mean(axis=0)) ** 2)) / places.shape[1]
            freedom += len(group) - 1
        spread[name] = squares / max(freedom, 1) + STRAIGHT_M**2
    return min(spread, key=spread.__getitem__)


def _seen(recording: Recording, name: str, begin: float, end: float) -> Array:
    """Places (S, 3) of the hand in a part of the movement, as a frame sees it."""
    shares = recording.times / recording.duration
    at = np.abs(np.linspace(begin, end, 10)[:, None] - shares).argmin(axis=1)
    return np.asarray(compose(inverse(recording.frames[name][at]), recording.movement[at])[:, :3])
