# SPDX-License-Identifier: Apache-2.0
"""A model and the frames it meets, held against the task that both are for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tpgmm_core import TPGMM, Frame
from tpgmm_core.manifold import POSE
from tpgmm_ros.conversions import TaskFrameState
from tpgmm_ros.task import DIMENSIONS, MANIFOLD, Task


def load_model(path: str | Path, task: Task) -> TPGMM:
    """A model that fits a task.

    Raises:
        ValueError: the file is no model, or the model encodes something else than the task describes.
        OSError: the file cannot be read.
    """
    model = TPGMM.load(path)
    if str(model.manifold_) != MANIFOLD or tuple(model.dimensions_ or ()) != DIMENSIONS:
        raise ValueError(
            f"{path} encodes {model.dimensions_} on {model.manifold_}; "
            f"task '{task.name}' needs {DIMENSIONS} on {MANIFOLD}"
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
