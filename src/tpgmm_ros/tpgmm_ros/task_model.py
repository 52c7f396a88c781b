# SPDX-License-Identifier: Apache-2.0
"""A model and the frames it meets, held against the task that both are for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tpgmm_core import TPGMM, Frame
from tpgmm_core.manifold import POSE, Manifold
from tpgmm_core.retrieval import ways
from tpgmm_core.retrieval.encodings import encoding_of
from tpgmm_ros.conversions import TaskFrameState
from tpgmm_ros.task import DIMENSIONS, MANIFOLD, Task


def load_model(path: str | Path, task: Task) -> TPGMM:
    """A model that fits a task, whatever it encodes of the task's movements.

    Raises:
        ValueError: the file is no model, or the model is of something else than the task describes.
        OSError: the file cannot be read.
    """
    model = ways.load_model(path)
    encoding, space = encoding_of(model), Manifold.parse(MANIFOLD)
    manifold, dimensions = encoding.manifold(space), encoding.dimensions(DIMENSIONS, space)
    if model.manifold_ != manifold or tuple(model.dimensions_ or ()) != dimensions:
        raise ValueError(
            f"{path} encodes {model.dimensions_} on {model.manifold_}; "
            f"task '{task.name}' needs {dimensions} on {manifold}"
        )
    unknown = [name for name in model.frame_names_ if name not in task.frames]
    if unknown:
        raise ValueError(
            f"{path} was learned from the frames {', '.join(model.frame_names_)}; task '{task.name}' "
            f"names {', '.join(task.frames)} and lacks {', '.join(unknown)}"
        )
    return model


def known_frames(states: Mapping[str, TaskFrameState]) -> dict[str, tuple[Frame, float]]:
    """Those frames that are not missing, as they act on [time, pose], and how far each is trusted.

    Raises:
        ValueError: a frame that does not act on poses.
    """
    known = {}
    for name, state in states.items():
        if state.frame is None:
            continue
        try:
            POSE.tangent_map(state.frame.A)
        except ValueError as error:
            raise ValueError(f"frame '{name}': {error}") from error
        known[name] = state.frame.with_time(), state.weight
    return known
