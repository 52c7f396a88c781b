# SPDX-License-Identifier: Apache-2.0
"""Entries of the part `kinematic` of a task file: tasks, hierarchies and postures, checked against each other."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from tpgmm_core.common.text import shown
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_choice, a_name
from tpgmm_core.kinematics.hierarchy import Level
from tpgmm_core.kinematics.tasks import KinematicTask


def read_tasks(section: Section, objects: Collection[str]) -> tuple[dict[str, KinematicTask], frozenset[str]]:
    """The tasks by name, and those that aim at their objects.

    Parameters
    ----------
    section
        `tasks`
    objects
        names of the task's frames

    Returns
    -------
    dict[str, KinematicTask]
        the tasks by name
    frozenset[str]
        names of those that aim at the objects that they are relative to

    Raises
    ------
    YamlError
        an entry is no task
    """
    if not section.values:
        raise section.error("is empty: name at least one task, such as 'left: {point: left, relative_to: object}'")
    tasks, aims = {}, set()
    for name in section.values:
        try:
            a_name(name)
        except ValueError as error:
            raise section.error(f"has the task name {shown(name)}, expected {error}") from None
        entry = section.section(name)
        entry.refuse_others("point", "part", "relative_to", "aim")
        point, values = entry.required("point", a_name), entry.values
        part: Any = "position"
        if "part" in values:
            part = entry.required("part", a_choice("position", "orientation", "pose"))
        relative_to = entry.required("relative_to", a_name) if "relative_to" in values else None
        if relative_to == point:
            raise entry.error(
                f"has the point {shown(point)} relative to itself; expected a frame of the task or another point"
            )
        if "aim" in values and entry.required("aim", a_choice("object", "learned")) == "object":
            if relative_to not in objects:
                raise entry.error(
                    f"aims at its object and is relative to {shown(relative_to)}; expected one of the task's frames: "
                    + ", ".join(objects)
                )
            aims.add(name)
        tasks[name] = KinematicTask(point, part, relative_to)
    return tasks, frozenset(aims)


def read_hierarchies(section: Section, tasks: Collection[str]) -> dict[str, tuple[Level, ...]]:
    """The hierarchies by name: levels, most important first.

    Parameters
    ----------
    section
        `hierarchies`
    tasks
        names of the tasks

    Returns
    -------
    dict[str, tuple[Level, ...]]
        the levels of each

    Raises
    ------
    YamlError
        an entry is no hierarchy of these tasks
    """
    if not section.values:
        raise section.error("is empty: name at least one hierarchy, such as 'left before right: [left, right]'")
    return {name: section.required(name, lambda value: _levels(value, tasks)) for name in section.values}


def _levels(value: Any, tasks: Collection[str]) -> tuple[Level, ...]:
    expected = ValueError(
        f"levels, most important first, each one of the tasks {', '.join(tasks)} or a list of some, and each task once"
    )
    if not isinstance(value, list) or not value:
        raise expected
    used = [task for level in value for task in (level if isinstance(level, list) else [level])]
    if not all(isinstance(task, str) and task in tasks for task in used) or len(set(used)) < len(used) or [] in value:
        raise expected
    return tuple(tuple(level) if isinstance(level, list) else level for level in value)


def read_postures(section: Section, tasks: Collection[str]) -> tuple[tuple[str, ...], ...]:
    """For each posture, the tasks that it is below.

    Parameters
    ----------
    section
        `kinematic`, which has the key `postures`
    tasks
        names of the tasks

    Returns
    -------
    tuple[tuple[str, ...], ...]
        names of tasks; none for the posture of all joints

    Raises
    ------
    YamlError
        the value is no list of lists of these tasks
    """

    def read(value: Any) -> tuple[tuple[str, ...], ...]:
        expected = ValueError(f"a list of lists of tasks that are above a posture, some of {', '.join(tasks)} or none")
        if not isinstance(value, list) or not all(isinstance(above, list) for above in value):
            raise expected
        if not all(isinstance(task, str) and task in tasks for above in value for task in above):
            raise expected
        return tuple(tuple(above) for above in value)

    postures: tuple[tuple[str, ...], ...] = section.required("postures", read)
    return postures


def joint_groups(value: Any) -> tuple[str, ...]:
    """A value that must be a name of a joint or group, or a list of them.

    Parameters
    ----------
    value
        as YAML holds it

    Returns
    -------
    tuple[str, ...]
        the names

    Raises
    ------
    ValueError
        with what was expected
    """
    names = value if isinstance(value, list) else [value]
    if not names or not all(isinstance(name, str) and name for name in names):
        raise ValueError("joints or groups of joints of the robot file, such as [left_arm, right_arm]")
    return tuple(names)
