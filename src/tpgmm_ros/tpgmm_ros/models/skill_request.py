# SPDX-License-Identifier: Apache-2.0
"""What a goal asks for, and the skills that are made of it: read, held against the task, and rehearsed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpgmm_core import Frame, LearnedMixture
from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.retrieval.novelty import Novelty, NoveltyScale
from tpgmm_core.retrieval.skill_sequence import QueuedSkill
from tpgmm_ros.models.task_model import load_task_model, make_task_retrieval
from tpgmm_ros.task.task_file import Task

MAX_SKILLS = 100
"""A goal with more is refused: somebody else's mistake must not fill the memory."""


@dataclass(frozen=True, slots=True)
class SkillRequest:
    """One skill that a goal asks for.

    Parameters
    ----------
    path
        of the model file; empty: the model in use
    duration
        s; 0: as demonstrated
    hold
        how long the robot stays at its end before the next one begins, s
    """

    path: str = ""
    duration: float = 0.0
    hold: float = 0.0


def skill_requests(
    model: str, duration: float, models: Sequence[str], durations: Sequence[float], holds: Sequence[float]
) -> list[SkillRequest]:
    """What a goal of the action ``reproduce`` asks for.

    Parameters
    ----------
    model, duration, models, durations, holds
        its fields

    Returns
    -------
    list[SkillRequest]
        one, or those of `models` in their order

    Raises
    ------
    ValueError
        for fields that do not go together
    """
    if not models:
        if durations or holds:
            raise ValueError("'durations' and 'holds' are for the skills of 'models', which is empty")
        return [SkillRequest(model, duration)]
    N = len(models)
    if model:
        raise ValueError("the goal names both 'model' and 'models': give one of them")
    if duration:
        raise ValueError(f"'duration' is for one movement: give 'durations', one for each of the {N} models")
    if N > MAX_SKILLS:
        raise ValueError(f"the goal names {N} models, expected at most {MAX_SKILLS}")
    if durations and len(durations) != N:
        raise ValueError(f"there are {len(durations)} durations for {N} models: give one for each, or none")
    if holds and len(holds) != N - 1:
        raise ValueError(f"there are {len(holds)} holds for {N} models: give {N - 1}, one between each two, or none")
    if empty := [i + 1 for i, path in enumerate(models) if not path]:
        raise ValueError(f"no file is named for skill {listed(empty)}")
    return [
        SkillRequest(path, durations[i] if durations else 0.0, holds[i] if holds and i < N - 1 else 0.0)
        for i, path in enumerate(models)
    ]


@dataclass(frozen=True, slots=True)
class Prepared:
    """A skill that may begin.

    Parameters
    ----------
    model
        what it was learned as
    skill
        a movement of it that has not begun yet
    novelty
        how new the situation is to it; None where that cannot be told
    """

    model: LearnedMixture
    skill: QueuedSkill
    novelty: Novelty | None


def prepare(
    requests: Sequence[SkillRequest],
    model: LearnedMixture | None,
    task: Task,
    settings: Mapping[str, Any],
    known: Mapping[str, tuple[Frame, float]],
    state: Array | None,
    max_novelty: float,
) -> list[Prepared]:
    """Read the models of skills, each file once, and make movements of them that may begin.

    A rehearsal refuses what cannot be adapted to the situation before anything depends on it. How new the situation is
    to a later skill is judged by what is known now, and not at all as long as its frames are not seen.

    Parameters
    ----------
    requests
        one or more
    model
        the one in use, for a request that names no file
    task
        what the models have to fit
    settings
        of `make_task_retrieval`, without `duration`
    known
        frames by name, and how far each is trusted
    state
        where the robot is; None where not known
    max_novelty
        the largest that is not refused; 0: all

    Returns
    -------
    list[Prepared]
        in the order of the requests

    Raises
    ------
    ValueError
        for a skill that cannot be reproduced, with its number where there are several
    OSError
        for a file that cannot be read
    """
    read: dict[str, LearnedMixture] = {}
    found = []
    for i, request in enumerate(requests):
        try:
            if request.path and request.path not in read:
                read[request.path] = load_task_model(request.path, task)
            chosen = read[request.path] if request.path else model
            if chosen is None:
                raise ValueError("no model is loaded: name a model file in the goal, or set the parameter model_file")
            found.append(_prepared(request, chosen, task, settings, known, state, max_novelty, is_first=i == 0))
        except ValueError as error:
            if len(requests) == 1:
                raise
            raise ValueError(f"skill {i + 1} of {len(requests)}: {error}") from error
    return found


def _prepared(
    request: SkillRequest,
    model: LearnedMixture,
    task: Task,
    settings: Mapping[str, Any],
    known: Mapping[str, tuple[Frame, float]],
    state: Array | None,
    max_novelty: float,
    *,
    is_first: bool,
) -> Prepared:
    retrieval = make_task_retrieval(model, task, duration=request.duration or None, **settings)
    derived = DerivedFrames.of_metadata(model.metadata_)
    skill = QueuedSkill(Path(request.path).stem, retrieval, derived, request.hold)
    frames, weights = skill.frames(known, state)
    if frames and not (state is None and task.space.needs_state):
        retrieval.start(0, state)
        retrieval.step(0, frames, state, weights)
    return Prepared(model, skill, _judged(model, skill, frames, state, max_novelty, is_first))


def _judged(
    model: LearnedMixture,
    skill: QueuedSkill,
    frames: Mapping[str, Frame],
    state: Array | None,
    most: float,
    is_first: bool,
) -> Novelty | None:
    """How new a situation is. With a limit `most` above 0, ValueError beyond it, and where that cannot be told."""
    scale = NoveltyScale.of_model(model)
    unseen = [name for name in skill.retrieval.frame_names if name not in frames]
    if scale is None or unseen:
        if most > 0.0 and scale is None:
            raise ValueError(
                "max_novelty is set, but the model does not say what is new to it: train it with --leave-one-out"
            )
        if most > 0.0 and is_first:
            raise ValueError(f"max_novelty is set, but how new the situation is needs the frames {listed(unseen)}")
        return None
    novelty = scale.judge(skill.retrieval, frames, state)
    if 0.0 < most < novelty.score:
        raise ValueError(
            f"the situation is too new to the model: novelty {novelty.score:.2g}, max_novelty is {most:.2g}; {novelty}"
        )
    return novelty
