# SPDX-License-Identifier: Apache-2.0
"""How well a way of learning reproduces what it has not seen: by demonstration, by frame, and in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tpgmm_core import LearnedMixture
from tpgmm_core.choice.automatic import MISFIT
from tpgmm_core.choice.calibration import Calibration
from tpgmm_core.choice.novelty import range_of
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.calibrated import scale_key
from tpgmm_core.retrieval.methods import method_of
from tpgmm_core.retrieval.novelty import NoveltyScale
from tpgmm_ros.models.validation import Fold, cross_validate
from tpgmm_ros.recordings.recording import Recording, align
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.project.recipe import LearnedAs

SAMPLES = 100
"""Samples of each demonstration that errors are told of."""
FAR_M = 0.01
"""Errors that are less are no misfit, however small the others are."""


@dataclass(frozen=True, slots=True)
class HeldOutErrors:
    """What was found by leaving out each demonstration in turn.

    Parameters
    ----------
    errors
        of each demonstration in their order: "path_m", "turn_deg", "end_m", and "at <frame>_m" for each observed frame
    folds
        the reproductions
    """

    errors: tuple[Mapping[str, float], ...]
    folds: tuple[Fold, ...] = ()

    def misfits(self) -> dict[int, str]:
        """Which are reproduced much worse than the others: place in the order -> why; from three on."""
        if len(self.errors) < 3:
            return {}
        paths = np.array([error["path_m"] for error in self.errors])
        usual = float(np.median(paths))
        return {
            i: f"its error is {millimetres(value)}, that of the others {millimetres(usual)} (median); if it "
            "shows something else, leave it out; if its situation is unusual, show more like it"
            for i, value in enumerate(paths.tolist())
            if value > max(MISFIT * usual, FAR_M)
        }

    def words(self, names: Sequence[int]) -> tuple[str, ...]:
        """What the errors mean, most important first; names are the numbers of the demonstrations."""
        if not self.errors:
            return ("how well it reproduces what it has not seen is not known: show one more demonstration",)
        typical = {key: float(np.median([error[key] for error in self.errors])) for key in self.errors[0]}
        places = [
            f"{millimetres(value)} at the {key.removeprefix('at ').removesuffix('_m')}"
            for key, value in typical.items()
            if key.startswith("at ")
        ]
        worst = max(range(len(self.errors)), key=lambda i: self.errors[i]["path_m"])
        words = [
            f"reproduces what it has not seen to {', '.join([*places, millimetres(typical['end_m']) + ' at the end'])}",
            f"on the whole way to {millimetres(typical['path_m'])} and {typical['turn_deg']:.1f} deg; worst: "
            f"demonstration {names[worst]}, {millimetres(self.errors[worst]['path_m'])}",
        ]
        if len(self.errors) == 2:
            words.append("each of the two was reproduced from the other one alone: with a third the numbers say more")
        return tuple(words)


def leave_each_out(
    recordings: Sequence[Recording],
    task: Task,
    learned_as: LearnedAs,
    progress: Callable[[int], None] | None = None,
) -> HeldOutErrors:
    """Reproduce each recording with a model of the others.

    Parameters
    ----------
    recordings
        two or more
    task
        of these
    learned_as
        how models are learned
    progress
        called with how many were left out

    Returns
    -------
    HeldOutErrors
        without errors where models of the others cannot be learned
    """
    few = [thin(recording) for recording in recordings]
    folds: list[Fold] = []
    anchor = list(task.sources or task.frames)[-1]
    try:
        for fold in cross_validate(few, lambda shown: learned_as.learn(shown, task), anchor):
            folds.append(fold)
            if progress is not None:
                progress(len(folds))
    except (ValueError, np.linalg.LinAlgError):  # of one or two demonstrations no model may come
        return HeldOutErrors(())
    return HeldOutErrors(tuple(_errors(fold, tuple(task.sources)) for fold in folds), tuple(folds))


def judge_itself(model: LearnedMixture, recordings: Sequence[Recording], found: HeldOutErrors) -> None:
    """Write into a model how exact its references are, and what is new to it, as `train --leave-one-out` does."""
    if len(found.folds) < 2:
        return
    known = [fold.squared_distances for fold in found.folds if np.isfinite(fold.squared_distances).any()]
    if known:
        model.metadata_[scale_key(method_of(model).name)] = Calibration.of(known, POSE.tangent_dim).scale
    against, far = zip(*(fold.novelty for fold in found.folds), strict=True)
    if np.isfinite(against).all():
        model.metadata_ |= NoveltyScale(range_of(model, align(recordings)[0], POSE), against, far).metadata()


def thin(recording: Recording) -> Recording:
    """At most SAMPLES of a recording, the first and the last too."""
    T = len(recording.times)
    return recording if T <= SAMPLES else recording.at(np.linspace(0, T - 1, SAMPLES).round().astype(np.intp))


def millimetres(metres: float) -> str:
    """A length for people."""
    return f"{1e3 * metres:.1f} mm" if metres < 0.00995 else f"{1e3 * metres:.0f} mm"


def _errors(fold: Fold, names: Sequence[str]) -> dict[str, float]:
    shown = fold.recording
    away = np.linalg.norm(fold.path[:, :3] - shown.movement[:, :3], axis=1)
    at = {
        f"at {name}_m": float(
            away[np.argmin(np.linalg.norm(shown.movement[:, :3] - shown.frames[name][:, :3], axis=1))]
        )
        for name in names
    }
    return {
        "path_m": fold.model.position_rmse_m,
        "turn_deg": fold.model.orientation_mean_deg,
        "end_m": fold.model.position_end_m,
        **at,
    }
