# SPDX-License-Identifier: Apache-2.0
"""What a goal asks for, and the skills that are made of it: read, held against the task, and rehearsed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpgmm_core import Frame, LearnedMixture
from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.retrieval.interface import Retrieval, demonstrated_duration
from tpgmm_core.retrieval.knowledge import KnowledgeConfig
from tpgmm_core.retrieval.novelty import Novelty, NoveltyScale
from tpgmm_core.retrieval.parallel import Parallel
from tpgmm_core.retrieval.skill_sequence import QueuedSkill
from tpgmm_core.retrieval.waiting import Waiting
from tpgmm_ros.models.task_model import TOGETHER, load_task_models, make_task_retrieval
from tpgmm_ros.task.task_file import Task

MAX_SKILLS = 100
"""A goal with more is refused: somebody else's mistake must not fill the memory."""


@dataclass(frozen=True, slots=True)
class SkillRequest:
    """One skill that a goal asks for.

    Parameters
    ----------
    path
        of the model file, or of several with " + " between them, whose movements go on at the same time; empty: what is
        in use
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
        raise ValueError(f"no model file is given for skill {listed(empty)}")
    return [
        SkillRequest(path, durations[i] if durations else 0.0, holds[i] if holds and i < N - 1 else 0.0)
        for i, path in enumerate(models)
    ]


@dataclass(frozen=True, slots=True)
class Prepared:
    """A skill that may begin.

    Parameters
    ----------
    models
        what it was learned as; several where movements go on at the same time
    skill
        a movement of them that has not begun yet
    novelty
        how new the situation is to it, the largest of its models; None where that cannot be told
    """

    models: tuple[LearnedMixture, ...]
    skill: QueuedSkill
    novelty: Novelty | None


def prepare(
    requests: Sequence[SkillRequest],
    models: Sequence[LearnedMixture],
    task: Task,
    settings: Mapping[str, Any],
    known: Mapping[str, tuple[Frame, float]],
    state: Array | None,
    max_novelty: float,
    knowledge: KnowledgeConfig,
) -> list[Prepared]:
    """Read the models of skills, each file once, and make movements of them that may begin.

    A rehearsal refuses what cannot be adapted to the situation before anything depends on it. How new the situation is
    to a later skill is judged by what is known now, and not at all as long as its frames are not seen.

    Parameters
    ----------
    requests
        one or more
    models
        in use, for a request that names no file; none: there are none
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
    knowledge
        from when on too little is known, so that a movement waits

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
    read: dict[str, tuple[LearnedMixture, ...]] = {}
    found = []
    for i, request in enumerate(requests):
        try:
            if request.path and request.path not in read:
                read[request.path] = load_task_models(request.path, task)
            chosen = read[request.path] if request.path else tuple(models)
            if not chosen:
                raise ValueError("no model is loaded: name a model file in the goal, or set the parameter model_file")
            found.append(
                _prepared(request, chosen, task, settings, known, state, max_novelty, knowledge, is_first=i == 0)
            )
        except (ValueError, OSError) as error:
            if len(requests) == 1:
                raise
            raise ValueError(f"skill {i + 1} of {len(requests)}: {error}") from error
    return found


def _prepared(
    request: SkillRequest,
    models: tuple[LearnedMixture, ...],
    task: Task,
    settings: Mapping[str, Any],
    known: Mapping[str, tuple[Frame, float]],
    state: Array | None,
    max_novelty: float,
    knowledge: KnowledgeConfig,
    *,
    is_first: bool,
) -> Prepared:
    movements = _movements(request, models, task, settings)
    retrieval = _together(movements)
    if knowledge.unknown_ratio > 0.0:
        probe = _together(_movements(request, models, task, {**settings, "horizon_steps": 0}))
        retrieval = Waiting(retrieval, probe, knowledge)
    derived = DerivedFrames.joined(DerivedFrames.of_metadata(model.metadata_) for model in models)
    name = TOGETHER.join(Path(path).stem for path in request.path.split(TOGETHER))
    skill = QueuedSkill(name, retrieval, derived, request.hold)
    frames, weights = skill.frames(known, state)
    if frames and not (state is None and task.space.needs_state):
        retrieval.start(0, state)
        retrieval.step(0, frames, state, weights)
    judged = [
        _judged(model, movement, frames, state, max_novelty, is_first)
        for model, movement in zip(models, movements, strict=True)
    ]
    return Prepared(models, skill, newest(judged))


def _movements(
    request: SkillRequest, models: Sequence[LearnedMixture], task: Task, settings: Mapping[str, Any]
) -> list[Retrieval]:
    return [
        make_task_retrieval(model, task, duration=duration, **settings)
        for model, duration in zip(models, _durations(models, request.duration), strict=True)
    ]


def _together(movements: Sequence[Retrieval]) -> Retrieval:
    return movements[0] if len(movements) == 1 else Parallel(movements)


def newest(judged: Iterable[Novelty | None]) -> Novelty | None:
    """The largest of those that could be told."""
    return max((one for one in judged if one is not None), key=lambda one: one.score, default=None)


def _durations(models: Sequence[LearnedMixture], asked: float) -> list[float | None]:
    """How long each movement takes, s; None: as demonstrated. The longest takes what is asked; ratios are kept."""
    if not asked:
        return [None] * len(models)
    if len(models) == 1:
        return [asked]
    shown = [demonstrated_duration(model) for model in models]
    return [asked * one / max(shown) for one in shown]


def _judged(
    model: LearnedMixture,
    movement: Retrieval,
    frames: Mapping[str, Frame],
    state: Array | None,
    most: float,
    is_first: bool,
) -> Novelty | None:
    """How new a situation is. With a limit `most` above 0, ValueError beyond it, and where that cannot be told."""
    scale = NoveltyScale.of_model(model)
    frames = {name: frames[name] for name in movement.frame_names if name in frames}
    unseen = [name for name in movement.frame_names if name not in frames]
    if scale is None or unseen:
        if most > 0.0 and scale is None:
            raise ValueError("max_novelty is set, but the model cannot judge novelty: train it with --leave-one-out")
        if most > 0.0 and is_first:
            raise ValueError(
                "max_novelty is set, but the novelty of the situation is unknown until these frames are seen: "
                f"{listed(unseen)}"
            )
        return None
    novelty = scale.judge(movement, frames, state)
    if 0.0 < most < novelty.score:
        raise ValueError(
            f"the situation is too new for the model: novelty {novelty.score:.2g}, max_novelty is {most:.2g}; {novelty}"
        )
    return novelty
