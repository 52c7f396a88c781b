# SPDX-License-Identifier: Apache-2.0
"""Corrections: where the arm was led during a run, and how a model follows that at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core import LearnedMixture
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_ros.recordings.recording import Recording
from tpgmm_workbench.project.bag_writer import write_bag
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.held_out import millimetres
from tpgmm_workbench.project.lessons import frame_of, lessons_of
from tpgmm_workbench.project.notes import Correction, ModelNotes
from tpgmm_workbench.project.project import Project, TrainedModel, used_parts
from tpgmm_workbench.project.recipe import LearnedAs

LED_M, METRES_PER_RADIAN = 0.015, 0.1
"""A hand that is farther from its reference was led, where nobody says; a turn counts as so many metres."""
LEAVES = 0.3
"""Share of LED_M from which on the hand is about to leave the reference."""
LAG = 0.02
"""Share of the movement by which a hand may be behind its reference, or ahead."""
SHORTEST = 0.03
"""Share of the movement that a correction lasts at least."""
SAMPLES = 200
LEAST = 1e-4
"""Share of the movement between two samples at least: a movement that slows down to wait goes on by rounding errors."""
STARTS, ENDS = 0.1, 0.9
"""Shares of the movement between which a run has to be known."""
TAKEN_OVER = ("novelty", "covariance_scale.")
"""What the corrected model takes over from the one before: how exact and how sure it was found to be."""


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What the hand did while a model ran, and where the frames were.

    Parameters
    ----------
    times
        (T,) s, increasing
    hand
        (T, 7) poses in the base frame
    frames
        name -> (7,) or (T, 7) poses in the base frame, of all observed frames
    phases
        (T,) shares of the movement, 0 to 1, as the feedback of the action tells; None: in proportion to the time
    is_led
        (T,) where the arm was led; None: found from where the hand left the reference
    """

    times: Array
    hand: Array
    frames: Mapping[str, Array]
    phases: Array | None = None
    is_led: NDArray[np.bool_] | None = None


def correct(project: Project, run: Run, comment: str = "") -> TrainedModel:
    """Make a demonstration of a correction, and a model that follows it; both are kept, and `Project.undo` undoes both.

    It takes less than 5 s, so call it from a thread.

    Parameters
    ----------
    project
        whose present model ran
    run
        what happened
    comment
        of the user

    Returns
    -------
    TrainedModel
        the new one, which is the present one from now on

    Raises
    ------
    ProjectError
        where there is no model, or the hand was nowhere else than the model wanted it
    """
    present = project.model
    if present is None:
        raise ProjectError("there is no model that could be corrected: train one first")
    recording, told = _recording(project, present, run)
    begin, end = _led_part(project.load(present), recording, told)
    others = [one for one in project.used() if one.notes.correction is not None]
    same = [
        one.recording
        for one in others
        if (c := one.notes.correction) is not None and min(c.end, end) > max(c.begin, begin)
    ]
    lessons = [one.recording for one in project.shown()]
    frame = frame_of(lessons, [*same, recording], begin, end, tuple(project.task.frames))
    correction = Correction(present.number, begin, end, frame)
    frames = {name: recording.frames[name] for name in project.task.sources}
    project.add(
        lambda path: write_bag(path, project.task, recording.times, recording.movement, frames), comment, correction
    )
    return _relearned(project, present, correction)


def _relearned(project: Project, present: TrainedModel, correction: Correction) -> TrainedModel:
    shown = project.used()
    learned_as = present.notes.learned_as or LearnedAs.of_task(project.task)
    model = learned_as.learn_recordings(list(lessons_of(project, shown).values()), project.task)
    before = project.load(present)
    model.metadata_ |= {key: value for key, value in before.metadata_.items() if key.startswith(TAKEN_OVER)}
    words = (
        f"corrected from {correction.begin:.0%} to {correction.end:.0%} of the movement, as seen from "
        f"{correction.frame}; the rest is as it was",
    )
    notes = ModelNotes(
        learned_from=used_parts(shown),
        words=words,
        method=learned_as.method,
        n_components=len(model.priors_),
        corrects=present.number,
        learned_as=learned_as,
    )
    return project.keep(model, notes)


def _recording(project: Project, present: TrainedModel, run: Run) -> tuple[Recording, NDArray[np.bool_] | None]:
    """The run as a recording of the demonstrated duration, whose times are phases; and where the arm was led."""
    times, hand = np.asarray(run.times, float), np.asarray(run.hand, float)
    if len(times) < 10 or hand.shape != (len(times), 7) or not np.isfinite(hand).all() or (np.diff(times) <= 0.0).any():
        raise ProjectError(
            f"a run has 10 samples at least with increasing times and poses (T, 7); got {len(times)} times and poses "
            f"of shape {hand.shape}"
        )
    if missing := [name for name in project.task.sources if name not in run.frames]:
        raise ProjectError(f"the run does not say where {', '.join(missing)} was")
    phases = (times - times[0]) / (times[-1] - times[0]) if run.phases is None else np.asarray(run.phases, float)
    goes_on = _going_on(phases)
    if len(goes_on) < 10 or phases[goes_on[0]] > STARTS or phases[goes_on[-1]] < ENDS:
        first, last = (phases[goes_on[0]], phases[goes_on[-1]]) if len(goes_on) else (0.0, 0.0)
        raise ProjectError(
            f"the run went from {first:.0%} to {last:.0%} of the movement; a correction needs all of it: lead the arm, "
            "let go, and let the movement come to its end"
        )
    at = goes_on[np.unique(np.linspace(0, len(goes_on) - 1, SAMPLES).round().astype(int))]
    given = {**project.fixed_frames(), **run.frames}
    frames = {
        name: np.broadcast_to(np.asarray(given[name], float), (len(times), 7))[at] for name in project.task.frames
    }
    shares = (phases[at] - phases[at[0]]) / (phases[at[-1]] - phases[at[0]])
    recording = Recording(
        project.folder,
        shares * float(project.load(present).metadata_["duration_s"]),
        hand[at],
        frames,
        {name: np.ones(len(at), bool) for name in frames},
        derived=project.task.derived,
    )
    return recording, None if run.is_led is None else np.asarray(run.is_led, bool)[at]


def _going_on(phases: Array) -> NDArray[np.intp]:
    """The samples (at most T) at which a movement is farther than ever before, by `LEAST`: it may wait, or go back."""
    kept, farthest = [], -np.inf
    for i, phase in enumerate(phases):
        if phase >= farthest + LEAST:
            kept.append(i)
            farthest = phase
    return np.array(kept, dtype=np.intp)


def _led_part(model: LearnedMixture, recording: Recording, told: NDArray[np.bool_] | None) -> tuple[float, float]:
    """Shares of the movement between which the arm was led: as told, or the longest time away from the reference."""
    reference = reproduce(model, recording.to_demonstration())
    away = _away(recording.movement, reference)
    shares = recording.times / recording.duration
    led = away > LED_M if told is None else told
    edges = np.flatnonzero(np.diff(np.concatenate([[False], led, [False]]).astype(int)))
    begin, end = max(zip(edges[::2], edges[1::2] - 1, strict=True), key=lambda run: run[1] - run[0], default=(0, 0))
    if told is not None and len(edges):  # whoever feels the arm may lose it for a moment
        begin, end = edges[0], edges[-1] - 1
    if shares[end] - shares[begin] < SHORTEST:
        raise ProjectError(
            f"the hand was not led anywhere: it stayed within {millimetres(float(away.max()))} of where the model "
            "wanted "
            "it; hold the arm for longer, and lead it to where it should be"
        )
    if told is None:  # it had begun to leave the reference a little before, and came back a little after
        while begin > 0 and away[begin] > LEAVES * LED_M:
            begin -= 1
        while end < len(away) - 1 and away[end] > LEAVES * LED_M:
            end += 1
    return float(shares[begin]), float(shares[end])


def _away(hand: Array, reference: Array) -> Array:
    """How far the hand (T, 7) is from where the reference was or will be soon, (T,) m: lagging is not being led."""
    T = len(hand)
    lag = max(1, round(LAG * T))
    found = np.full(T, np.inf)
    for shift in range(-lag, lag + 1):
        other = reference[np.clip(np.arange(T) + shift, 0, T - 1)]
        far = np.linalg.norm(hand[:, :3] - other[:, :3], axis=1)
        far += METRES_PER_RADIAN * quaternion.angle_between(hand[:, 3:], other[:, 3:])
        found = np.minimum(found, far)
    return found
