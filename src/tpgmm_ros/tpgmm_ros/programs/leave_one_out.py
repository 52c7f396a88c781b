# SPDX-License-Identifier: Apache-2.0
"""Leave one out, as programs show it: errors beside those of simpler models, coverage, and what is new to a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.choice.baselines import Learner
from tpgmm_core.choice.calibration import Calibration
from tpgmm_core.choice.novelty import range_of
from tpgmm_core.common.report import format_table
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.calibrated import scale_key
from tpgmm_core.retrieval.novelty import NoveltyScale
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.models.training_record import keep_errors
from tpgmm_ros.models.validation import Fold, PathErrors, cross_validate, mean_baselines, mean_errors
from tpgmm_ros.programs.reading import progress_bar
from tpgmm_ros.recordings.bags import Recording, align
from tpgmm_ros.task.task_file import Task


def validate(
    task: Task, recipe: Recipe, recordings: list[Recording], trained: LearnedMixture, jobs: int = 1
) -> tuple[list[Fold], dict[str, Any]]:
    """Reproduce each demonstration by a model of the others, and print the errors.

    Parameters
    ----------
    task
        that the recordings are of, over poses
    recipe
        how models are learned
    recordings
        two or more
    trained
        the model of all of them, which is told how exact it is, what is new to it, and what errors to expect
    jobs
        processes

    Returns
    -------
    tuple[list[Fold], dict[str, Any]]
        one for each recording, and what JSON holds of all of it

    Raises
    ------
    ValueError
        for fewer than two recordings, and where nothing can be learned of the others.
    """
    anchor, space = list(task.sources or task.frames)[-1], task.space.manifold()
    folds: list[Fold] = []
    with progress_bar(total=len(recordings), desc="leave one out", unit="demonstration") as bar:
        learner = Learner.of(space, recipe.arguments)
        for fold in cross_validate(recordings, lambda shown: recipe.learn(shown, space), anchor, learner, jobs):
            folds.append(fold)
            bar.update()
    mean = mean_errors([fold.model for fold in folds])
    mean_nearest = mean_errors([fold.nearest for fold in folds])

    columns = ("RMSE m", "end m", "mean deg", "end deg")
    rows = [(fold.recording.name, *cells_of(fold.model), *cells_of(fold.nearest)) for fold in folds]
    rows.append(("mean", *cells_of(mean), *cells_of(mean_nearest)))
    print(f"\nleave one out: the model, and the nearest demonstration moved with the frame {anchor!r} (n.)")
    print(format_table(("left out", *columns, *(f"n. {column}" for column in columns)), rows))
    baselines = mean_baselines(folds)
    others = [(name, *cells_of(errors), count) for name, (errors, count) in baselines.items()]
    print(
        "\nother kinds of models, with the same number of components; means over the demonstrations "
        "that they can reproduce"
    )
    print(format_table(("", *columns, "left out"), [("this model", *cells_of(mean), len(folds)), *others]))
    print("\nmean position error in each tenth of the movement, m")
    print(
        format_table(
            ("", *(f"{tenth}0 %" for tenth in range(1, 11))),
            [
                (name, *(f"{value:.3f}" for value in errors.position_by_tenth_m))
                for name, errors in (("model", mean), ("nearest", mean_nearest))
            ],
        )
    )
    keep_errors(
        trained,
        "leave one out",
        mean.position_rmse_m,
        mean.position_end_m,
        mean.orientation_mean_deg,
    )
    calibration = _calibrate(folds, recipe, trained)
    novelty = _novelty(folds, align(recordings)[0], trained)
    return folds, {
        "anchor": anchor,
        "calibration": asdict(calibration),
        "novelty_rank_correlation": novelty,
        "mean": asdict(mean),
        "mean_nearest": asdict(mean_nearest),
        "mean_baselines": {name: asdict(errors) for name, (errors, _) in baselines.items()},
        "folds": [
            {
                "bag": fold.recording.place,
                "iterations": fold.iterations,
                **asdict(fold.model),
                "nearest": asdict(fold.nearest),
                "baselines": {name: asdict(errors) for name, errors in fold.baselines.items()},
            }
            for fold in folds
        ],
    }


def _calibrate(folds: list[Fold], recipe: Recipe, trained: LearnedMixture) -> Calibration:
    """Say how exact the references are that the model calls exact, and write the scale that mends it into the model."""
    found = Calibration.of([fold.squared_distances for fold in folds], POSE.tangent_dim)
    trained.metadata_[scale_key(recipe.method.name)] = found.scale
    rows = [
        (f"{level:.0%}", f"{share:.2f}", f"{found.scaled_coverage[level]:.2f}")
        for level, share in found.coverage.items()
    ]
    print("\ncoverage: share of the left-out poses inside the model's region of this probability")
    print(format_table(("region", "as learned", "scaled"), rows))
    print(f"covariances are scaled by {found.scale:.2f}, standard deviations by {found.scale**0.5:.2f}")
    return found


def _novelty(folds: list[Fold], demonstrations: list[Demonstration], trained: LearnedMixture) -> float | None:
    """Write what novelty was for what was left out into the model; returns its rank correlation with the error."""
    against, far = zip(*(fold.novelty for fold in folds), strict=True)
    if not np.isfinite(against).all():
        print("\nnovelty: not computed, because the frames of a left-out demonstration contradict each other too much")
        return None
    scale = NoveltyScale(range_of(trained, demonstrations, POSE), against, far)
    trained.metadata_ |= scale.metadata()
    errors = [fold.model.position_rmse_m for fold in folds]
    print(
        f"\nnovelty: in left-out demonstrations, frames contradict each other by {min(against):.2g} to "
        f"{max(against):.2g} standard deviations, and are up to {max(far):.2g} from their places in the others"
    )
    if min(np.ptp(against), np.ptp(errors)) == 0.0:
        return None
    from scipy.stats import spearmanr  # a quarter of a second, which only this line needs

    correlation = float(spearmanr(against, errors)[0])
    print(f"rank correlation of the contradiction with the error: {correlation:.2f}")
    return correlation


def cells_of(errors: PathErrors | Mapping[str, float]) -> tuple[str, ...]:
    """Cells of a table of errors, as they are or by name: RMSE m, end m, mean deg, end deg."""
    found = errors if isinstance(errors, Mapping) else asdict(errors)
    return (
        f"{found['position_rmse_m']:.3f}",
        f"{found['position_end_m']:.3f}",
        f"{found['orientation_mean_deg']:.1f}",
        f"{found['orientation_end_deg']:.1f}",
    )
