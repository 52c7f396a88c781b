# SPDX-License-Identifier: Apache-2.0
"""`train --online` and `train --update`: a model that goes on to learn from new recordings without the old ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import listed, one_line
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.incremental.online import OnlineTPGMM
from tpgmm_core.learning.model_header import ModelFileError
from tpgmm_core.learning.time_warping import KEY as WARP_KEY
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.own_end import KEY as END_KEY
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.segment_frames import KEY as PRUNE_KEY
from tpgmm_ros.models.task_model import load_task_model
from tpgmm_ros.models.training_record import forget_errors, keep_recordings, learned_from
from tpgmm_ros.models.validation import tried
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.task_file import Task


def online(recipe: Recipe) -> Recipe:
    """The same recipe, for a model that keeps what it needs to go on to learn.

    Parameters
    ----------
    recipe
        of a method whose models are mixtures

    Returns
    -------
    Recipe
        whose estimator is `OnlineTPGMM`

    Raises
    ------
    ValueError
        for a method whose models are something else, and frames that are left out of segments.
    """
    method = recipe.method
    if method.estimator is not TPGMM:
        raise ValueError(
            f"--online is for methods whose models are Gaussian mixtures over time; {method.name} learns a "
            f"{method.estimator.__name__}: leave out --online, and train again with all bags once there are more"
        )
    if recipe.prune:
        raise ValueError(
            f"{PRUNE_KEY} compares all demonstrations at once, and --online does not keep them: leave one of them out"
        )
    if recipe.own_end:
        raise ValueError(
            f"{END_KEY} is where all demonstrations ended, which --online does not keep: leave one of them out"
        )
    if recipe.time_warping:
        raise ValueError(
            f"{WARP_KEY} compares all demonstrations at once, and --online does not keep them: leave it out"
        )
    return replace(recipe, method=replace(method, estimator=OnlineTPGMM))


def load_online(path: Path, task: Task) -> OnlineTPGMM:
    """A model of the task that can be updated.

    Parameters
    ----------
    path
        of the model file
    task
        that it is for

    Returns
    -------
    OnlineTPGMM
        as it was saved

    Raises
    ------
    ValueError
        like `load_task_model`, and for a model that keeps nothing of its demonstrations.
    OSError
        the file cannot be read.
    """
    load_task_model(path, task)  # which says what does not fit, whatever kind of model it is
    try:
        return OnlineTPGMM.load(path)
    except ModelFileError as error:
        raise ValueError(
            f"{one_line(error)}: such a model cannot be updated; train it with --online, or train again with all bags"
        ) from None


def update(
    model: OnlineTPGMM, task: Task, recordings: list[Recording], progress: EmProgress
) -> tuple[dict[str, Any], list[str]]:
    """Learn from new recordings in addition, stretched to the duration of the model, and print what it made of them.

    Parameters
    ----------
    model
        which learns
    task
        that the recordings are of
    recordings
        the new ones
    progress
        see `TPGMM.fit`

    Returns
    -------
    tuple[dict[str, Any], list[str]]
        what JSON holds of it, and names of recordings that it has learned from before

    Raises
    ------
    ValueError
        for recordings that do not fit the model.
    """
    duration, before = demonstrated_duration(model), learned_from(model)
    names = [recording.path.name for recording in recordings]
    reproduces = not task.space.joints()
    errors = [[tried(model, item, duration).errors for item in recordings]] if reproduces else []
    encoding, space, metadata = task.space.encoding_of(model), task.space.manifold(), dict(model.metadata_)
    model.partial_fit([encoding.encode(item.to_demonstration(duration), space) for item in recordings], progress)
    encoding.finish(model)
    model.metadata_ = metadata
    for key, more in (("demonstrations", len(recordings)), ("samples", sum(len(r.times) for r in recordings))):
        model.metadata_[key] = int(model.metadata_.get(key, 0)) + more
    keep_recordings(model, [*before, *names])
    forget_errors(model)
    report: dict[str, Any] = {"influence": float(model.influence_), "learned_before": len(before)}
    if reproduces:
        errors.append([tried(model, item, duration).errors for item in recordings])
        pairs = [(b.position_rmse_m, a.position_rmse_m) for b, a in zip(*errors, strict=True)]
        report["position_rmse_m"] = {name: {"before": b, "after": a} for name, (b, a) in zip(names, pairs, strict=True)}
        rows = [(name, f"{b:.4f}", f"{a:.4f}") for name, (b, a) in zip(names, pairs, strict=True)]
        print("\nRMSE in m, reproduced by the model before and after it learned from these recordings")
        print(format_table(("", "before", "after"), rows))
    if model.influence_ < 1.0:
        print(f"they contradict what was learned before, and count {model.influence_:g} times as much as the others")
    return report, sorted(set(before) & set(names))


def said_twice(names: list[str]) -> str:
    """What to think of recordings that were learned from before, in words."""
    return (
        f"{listed(names)}: the model has already learned from recordings with these names; if they are the same, "
        "they count twice"
    )
