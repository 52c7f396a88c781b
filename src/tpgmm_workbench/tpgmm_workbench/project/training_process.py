# SPDX-License-Identifier: Apache-2.0
"""What the process of a training does: choose, learn, leave each demonstration out, keep the model."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import parent_process
from typing import Any

import numpy as np

from tpgmm_core import LearnedMixture
from tpgmm_core.choice.automatic import Choice, choose
from tpgmm_core.choice.trial import TrialResult
from tpgmm_core.common.text import listed, one_line
from tpgmm_ros.recordings.judging import doubts_about
from tpgmm_ros.recordings.recording import Recording, align
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.project.activities import Action, Facts, may
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.held_out import HeldOutErrors, judge_itself, leave_each_out, millimetres
from tpgmm_workbench.project.lessons import lessons_of
from tpgmm_workbench.project.notes import ModelNotes
from tpgmm_workbench.project.project import Project, TrainedModel, used_parts
from tpgmm_workbench.project.recipe import LearnedAs

CHOOSING = 0.8
"""Share of the progress that choosing counts."""
FEWEST_TO_CHOOSE = 3
NICE = 10
"""The robot's loop comes first."""

type TrainingProgress = Callable[[float, str], None]
"""Called with the share that is done, and what is being done."""


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How a model is learned.

    Parameters
    ----------
    is_automatic
        choose frames, method and settings as `train --auto` does; from three demonstrations on
    budget_s
        time for choosing
    method, n_components
        in place of those of the task file; None: as it says, or as chosen
    """

    is_automatic: bool = True
    budget_s: float = 60.0
    method: str | None = None
    n_components: int | None = None


def work(pipe: Any, folder: str, options: TrainingOptions) -> None:
    """Train, and tell how far it is; the target of the process. It ends with the process that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process decides what an interruption means
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.nice(NICE)
    try:
        project = Project.open(folder)
        found = learn(project, options, lambda share, words: pipe.send(("progress", share, words)))
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # from here on it is kept, and told of
        pipe.send(("done", project.keep(*found).number))
    except (ProjectError, ValueError, OSError, np.linalg.LinAlgError) as error:
        pipe.send(("failed", one_line(error)))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def train(project: Project, options: TrainingOptions, tell: TrainingProgress) -> TrainedModel:
    """Learn from the demonstrations that are used, and keep the model: see `learn`.

    Parameters
    ----------
    project, options, tell
        as for `learn`

    Returns
    -------
    TrainedModel
        the present one from now on
    """
    return project.keep(*learn(project, options, tell))


def learn(project: Project, options: TrainingOptions, tell: TrainingProgress) -> tuple[LearnedMixture, ModelNotes]:
    """Learn from the demonstrations that are used.

    Parameters
    ----------
    project
        with two at least
    options
        how
    tell
        called now and then

    Returns
    -------
    tuple[LearnedMixture, ModelNotes]
        a model, and what is known of it

    Raises
    ------
    ValueError
        for demonstrations that cannot be learned from, with the reason
    """
    begin, task = time.monotonic(), project.task
    tell(0.0, "reading the demonstrations")
    shown = project.used()
    lessons = lessons_of(project, shown)
    if reason := may(Action.TRAIN, Facts(demonstrations=len(lessons))):
        raise ProjectError(reason)
    numbers, recordings = list(lessons), list(lessons.values())
    doubts = doubts_about(recordings, task)
    refusing = [str(doubt) for doubt in doubts if doubt.refuses]
    if refusing:
        raise ProjectError(f"these demonstrations do not belong together: {'; '.join(refusing)}")
    learned_as, why = _chosen(recordings, task, options, tell)
    tell(CHOOSING, "leaving each demonstration out")

    def left_out(count: int) -> None:
        share = CHOOSING + (1.0 - CHOOSING) * count / (len(recordings) + 1)
        tell(share, f"{count} of {len(recordings)} demonstrations were left out and reproduced")

    found = leave_each_out(recordings, task, learned_as, left_out)
    model = learned_as.learn_recordings(recordings, task)
    judge_itself(model, recordings, found)
    misfits = {numbers[i]: why for i, why in found.misfits().items()}
    by_path = {recording.place: number for recording, number in zip(recordings, numbers, strict=True)}
    for doubt in doubts:
        if doubt.kind == "misfit":
            misfits |= {by_path[name]: doubt.text for name in doubt.about if name in by_path}
    notes = ModelNotes(
        learned_from=used_parts(shown),
        words=_words(found, numbers, misfits, learned_as, why),
        method=learned_as.method,
        n_components=len(model.priors_),
        errors={number: dict(error) for number, error in zip(numbers, found.errors, strict=False)},
        misfits=misfits,
        learned_as=learned_as,
    )
    return model, replace(notes, seconds=round(time.monotonic() - begin, 2))


def _chosen(
    recordings: Sequence[Recording], task: Task, options: TrainingOptions, tell: TrainingProgress
) -> tuple[LearnedAs, str]:
    """How to learn, and why so."""
    given = LearnedAs.of_task(task, options.method, options.n_components)
    if not options.is_automatic or options.n_components is not None:
        return given, "with the settings of the task file and your choices"
    if len(recordings) < FEWEST_TO_CHOOSE:
        return (
            given,
            f"with the settings of the task file: choosing others needs {FEWEST_TO_CHOOSE} demonstrations",
        )
    begin, tried = time.monotonic(), 0

    def progress(result: TrialResult, best: TrialResult) -> None:
        nonlocal tried
        tried += 1
        share = CHOOSING * min(1.0, (time.monotonic() - begin) / options.budget_s)
        tell(share, f"{tried} configurations tried; the best so far, {best.trial.method}: {millimetres(best.cost)}")

    tell(0.0, "choosing frames, method and settings")
    demonstrations, _ = align(recordings)
    choice: Choice = choose(
        demonstrations,
        task.space.manifold(),
        dict(task.model),
        task.derived,
        methods=None if options.method is None else (options.method,),
        seconds=options.budget_s,
        progress=progress,
    )
    still = f"; hardly moved, so its influence is not known: {listed(choice.still)}" if choice.still else ""
    return LearnedAs.of_choice(choice), f"the best of {len(choice.search.results)} ways that were tried{still}"


def _words(
    found: HeldOutErrors, numbers: Sequence[int], misfits: dict[int, str], learned_as: LearnedAs, why: str
) -> tuple[str, ...]:
    return (
        *found.words(numbers),
        *(f"demonstration {number} does not fit the others: {text}" for number, text in sorted(misfits.items())),
        f"learned with {learned_as.method} in the frames {listed(learned_as.frames)}: {why}",
    )
