# SPDX-License-Identifier: Apache-2.0
"""Which topics a recording of a task holds: the sources of its hand and of its frames, and what shows the robot."""

from __future__ import annotations

from collections.abc import Iterable

from tpgmm_ros.messages.sources import TF, TF_MESSAGE, TF_STATIC, JointStateSource, Source, TransformSource
from tpgmm_ros.recordings.joint_streams import JOINT_STATE
from tpgmm_ros.task.takes_section import TopicTakes
from tpgmm_ros.task.task_file import Task

__all__ = ["JOINT_STATE", "ROBOT_DESCRIPTION", "needed_topics", "topics_of"]

ROBOT_DESCRIPTION = "robot_description"
"""What draws the robot: its URDF."""


def needed_topics(task: Task) -> dict[str, str]:
    """Topics without which no demonstration of a task can be read.

    Parameters
    ----------
    task
        of the task file

    Returns
    -------
    dict[str, str]
        types by topic; absolute names are those of all namespaces
    """
    found: dict[str, str] = {}
    hand: Source | JointStateSource | None = task.recorded_movement
    if task.recordings is not None:
        found[task.recordings.pose_array] = "geometry_msgs/msg/PoseArray"
    elif hand is None:
        found[task.movement] = "geometry_msgs/msg/PoseStamped"
    for source in (hand, *task.sources.values()):
        if isinstance(source, TransformSource):
            found |= {f"/{TF}": TF_MESSAGE, f"/{TF_STATIC}": TF_MESSAGE}
        elif isinstance(source, JointStateSource):
            found[source.topic] = JOINT_STATE
        elif source is not None:
            found[source.topic] = source.message_type
    return found | ({task.space.joint_states: JOINT_STATE} if task.space.joints() else {})


def topics_of(task: Task, further: Iterable[str] = ()) -> dict[str, str | None]:
    """Topics that a recording of a task holds.

    Beside those that the task needs, they are the joint states, what draws the robot elsewhere (its description and
    the transforms), and what cuts the recording into takes.

    Parameters
    ----------
    task
        of the task file
    further
        other topics

    Returns
    -------
    dict[str, str | None]
        types by topic; None: as it is published
    """
    cuts = (task.takes.topic,) if isinstance(task.takes, TopicTakes) else ()
    others = (ROBOT_DESCRIPTION, f"/{TF}", f"/{TF_STATIC}", *cuts, *further)
    return {**dict.fromkeys(others), task.space.joint_states: JOINT_STATE, **needed_topics(task)}
