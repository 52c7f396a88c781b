# SPDX-License-Identifier: Apache-2.0
"""Poses that are known already as an ordinary bag of a task's topics: for corrections, which no recorder saw."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.conversion import written
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.project.errors import ProjectError


def write_bag(path: Path, task: Task, times: Array, hand: Array, frames: Mapping[str, Array]) -> None:
    """Write the topics of a task.

    Parameters
    ----------
    path
        folder of the bag, which must not exist
    task
        names the topics
    times
        (T,) s, increasing
    hand
        (T, 7) poses in the base frame
    frames
        name -> (7,) or (T, 7) poses in the base frame, of all observed frames

    Raises
    ------
    ProjectError
        for a task whose frames or movement are no topics of PoseStamped, and a frame that is not given
    """
    topics = {task.movement: hand}
    for name in task.sources:
        if name not in task.topics or task.recordings is not None or task.recorded_movement is not None:
            raise ProjectError(
                f"task {task.name!r} does not take all its poses from topics of PoseStamped, and only these can be "
                "written here: record the correction as a bag instead"
            )
        if name not in frames:
            raise ProjectError(f"the pose of the frame {name!r} is not given; expected {', '.join(task.sources)}")
        topics[task.topics[name]] = np.broadcast_to(frames[name], (len(times), 7))
    written.write_bag(path, np.rint(1e9 * (times - times[0])).astype(np.int64), topics, task.base_frame)
