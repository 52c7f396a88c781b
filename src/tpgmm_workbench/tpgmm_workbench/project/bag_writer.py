# SPDX-License-Identifier: Apache-2.0
"""Poses that are known already as an ordinary bag of a task's topics: for corrections, which no recorder saw."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tpgmm_core.common.types import Array
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.project.errors import ProjectError

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
EPOCH_NS = 1_000_000_000
"""Stamps begin here: a stamp of zero means that there is none."""


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
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(f"/{topic}", POSE_STAMPED, typestore=store) for topic in topics}
        for i, time in enumerate(times - times[0]):
            ns = EPOCH_NS + round(1e9 * float(time))
            for topic, poses in topics.items():
                message = _message(store.types, task.base_frame, ns, poses[i])
                writer.write(connections[topic], ns, store.serialize_cdr(message, POSE_STAMPED))


def _message(types: Any, frame_id: str, ns: int, pose: Array) -> Any:
    x, y, z, qx, qy, qz, qw = map(float, pose)
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
    return types[POSE_STAMPED](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id),
        pose=types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=types["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
        ),
    )
