# SPDX-License-Identifier: Apache-2.0
"""A model and the frames it meets, held against the task that both are for."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tpgmm_core import Frame, LearnedMixture
from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.methods import load_model, make_retrieval
from tpgmm_ros.task.task_file import Task

if TYPE_CHECKING:  # messages need rclpy, and models do not
    from tpgmm_ros.messages.conversions import TaskFrameState

TOGETHER = " + "
"""Between the paths of models whose movements go on at the same time."""


def load_task_model(path: str | Path, task: Task) -> LearnedMixture:
    """A model that fits a task, whatever it encodes of the task's movements.

    Parameters
    ----------
    path
        of the model file; ~ is the home folder
    task
        what the model is for

    Returns
    -------
    LearnedMixture
        a fitted model

    Raises
    ------
    ValueError
        the file is no model, or the model is of something else than the task describes.
    OSError
        the file cannot be read.
    """
    model, space = load_model(os.path.expanduser(path)), task.space
    try:
        encoding = space.encoding_of(model)
        derived = DerivedFrames.of_metadata(model.metadata_)
    except ValueError as error:
        raise ValueError(f"{one_line(path)} does not fit task '{task.name}': {error}") from error
    manifold, dimensions = (
        encoding.manifold(space.manifold()),
        encoding.dimensions(space.dimensions(), space.manifold()),
    )
    if model.manifold_ != manifold or tuple(model.dimensions_ or ()) != dimensions:
        raise ValueError(
            f"{one_line(path)} encodes {listed(model.dimensions_ or ())} on {model.manifold_}; "
            f"task '{task.name}' needs {dimensions} on {manifold}"
        )
    needed = derived.observed(model.frame_names_)
    unknown = [name for name in needed if name not in space.frame_names or name in task.derived.sources]
    if unknown:
        raise ValueError(
            f"{one_line(path)} was learned from the frames {listed(model.frame_names_)}; task '{task.name}' "
            f"names {listed(space.frame_names)} and lacks {listed(unknown)}"
        )
    return model


def load_task_models(path: str | Path, task: Task) -> tuple[LearnedMixture, ...]:
    """Models that fit a task, for movements at the same time.

    Parameters
    ----------
    path
        of a model file, or of several with `TOGETHER` between them
    task
        what the models are for

    Returns
    -------
    tuple[LearnedMixture, ...]
        in their order

    Raises
    ------
    ValueError, OSError
        like `load_task_model`
    """
    return tuple(load_task_model(one, task) for one in str(path).split(TOGETHER))


def make_task_retrieval(model: LearnedMixture, task: Task, method: str | None = None, **settings: Any) -> Retrieval:
    """A movement of a model that fits the task.

    Parameters
    ----------
    model
        a fitted model
    task
        what it is for
    method
        retrieval method by name; None: what the model was learned for
    **settings
        as for `tpgmm_core.retrieval.methods.make_retrieval`

    Returns
    -------
    Retrieval
        the movement, before its start

    Raises
    ------
    ValueError
        a model that does not suit the method, or settings that it cannot have.
    OSError
        the robot file of kinematic frames cannot be read.
    """
    return make_retrieval(model, task.space.method(method), **settings)


def known_frames(states: Mapping[str, TaskFrameState]) -> dict[str, tuple[Frame, float]]:
    """Those frames that are not missing, as they act on [time, pose], and how far each is trusted.

    Parameters
    ----------
    states
        by name

    Returns
    -------
    dict[str, tuple[Frame, float]]
        by name

    Raises
    ------
    ValueError
        a frame that does not act on poses.
    """
    known = {}
    for name, state in states.items():
        if state.frame is None:
            continue
        try:
            POSE.tangent_map(state.frame.A)
        except ValueError as error:
            raise ValueError(f"frame {shown(name)}: {error}") from error
        known[name] = state.frame.with_time(), state.weight
    return known
