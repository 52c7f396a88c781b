# SPDX-License-Identifier: Apache-2.0
"""Candidate hierarchies of tasks as data, and the frames that distinguish them.

A hierarchy is a sequence of levels, most important first; a level is one task or several of equal rank:

    {"left before right": ["left", "right"], "right before left": ["right", "left"], "together": [["left", "right"]]}

Each level becomes one frame: tasks of the first level by Eqs. (8) and (9), those below by Eqs. (11) and (12) in the
null space of all above them. A level that several hierarchies have in common is one frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tpgmm_core.kinematics.frames import KinematicFrame, SecondaryTaskSpace, TaskSpace
from tpgmm_core.kinematics.tasks import KinematicTask

Level = str | Sequence[str]


def level_names(hierarchy: Sequence[Level]) -> list[str]:
    """Names of the frames of a hierarchy's levels, such as "left + right" and "elbow below left, right"."""
    names: list[str] = []
    above: list[str] = []
    for level in hierarchy:
        tasks = _tasks_of(level)
        below = f" below {', '.join(above)}" if above else ""
        names.append(" + ".join(tasks) + below)
        above.extend(tasks)
    return names


def hierarchy_frames(
    tasks: Mapping[str, KinematicTask], hierarchies: Mapping[str, Sequence[Level]], *, least_error: bool = True
) -> dict[str, KinematicFrame]:
    """The frames of all levels of all candidates, by `level_names`.

    Parameters
    ----------
    tasks
        name → Task
    hierarchies
        name → levels, each the name of a task, or names of tasks of equal rank
    least_error
        of lower levels, see `SecondaryTaskSpace`

    Returns
    -------
    dict[str, KinematicFrame]
        name → frame

    Raises
    ------
    ValueError
        for unknown tasks, levels without one, and a task that a hierarchy has twice
    """
    frames: dict[str, KinematicFrame] = {}
    for name, hierarchy in hierarchies.items():
        levels = [_tasks_of(level) for level in hierarchy]
        used = [task for level in levels for task in level]
        unknown = [task for task in used if task not in tasks]
        if unknown or not levels or not all(levels) or len(set(used)) != len(used):
            raise ValueError(
                f"hierarchy {name!r} has at least one level, each with tasks of {sorted(tasks)}, and each task once; "
                f"got {[list(level) for level in levels]}"
            )
        above: tuple[KinematicTask, ...] = ()
        for label, level in zip(level_names(hierarchy), levels, strict=True):
            here = tuple(tasks[task] for task in level)
            frames[label] = SecondaryTaskSpace(here, above, least_error) if above else TaskSpace(here)
            above += here
    return frames


def _tasks_of(level: Level) -> tuple[str, ...]:
    return (level,) if isinstance(level, str) else tuple(level)
