# SPDX-License-Identifier: Apache-2.0
"""Bags with affine maps beside poses, with the definitions that are installed, as `record` writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from synthetic_bags import START_S
from tpgmm_core import Frame
from tpgmm_msgs.msg import TaskFrame
from tpgmm_ros.recordings.storage.bag_writer import BagWriter
from tpgmm_ros.recordings.storage.definitions import types_for

TASK_PARAMETERS, POSE_STAMPED = "tpgmm_msgs/msg/TaskParameters", "geometry_msgs/msg/PoseStamped"


def maps(name: str, position: np.ndarray, turned: np.ndarray, stretches: np.ndarray) -> list[TaskFrame]:
    """A visible frame for each stretch (T, 3, 3)."""
    frames = [Frame.from_pose(position, turned, stretch=stretch) for stretch in stretches]
    return [
        TaskFrame(name=name, confidence=1.0, rows=7, cols=7, a=frame.A.ravel().tolist(), b=frame.b.tolist())
        for frame in frames
    ]


def write_map_bag(
    path: Path, poses: Mapping[str, np.ndarray], frames: Mapping[str, Sequence[TaskFrame]], times: np.ndarray
) -> Path:
    """A bag with poses (T, 7) and frames (T), by topic, at times (T,), s."""
    path.parent.mkdir(exist_ok=True)
    writer = BagWriter(path)
    kinds = dict.fromkeys(poses, POSE_STAMPED) | dict.fromkeys(frames, TASK_PARAMETERS)
    topics = {name: writer.add_topic(name, kind, types_for(kind)) for name, kind in kinds.items()}
    for t, time in enumerate(times):
        at = int(START_S) * 1_000_000_000 + round(1e9 * float(time))
        for name, several in poses.items():
            writer.write(topics[name], at, _serialised(POSE_STAMPED, at, pose=several[t]))
        for name, items in frames.items():
            writer.write(topics[name], at, _serialised(TASK_PARAMETERS, at, frame=items[t]))
    return writer.close()


def _serialised(kind: str, at: int, pose: np.ndarray | None = None, frame: TaskFrame | None = None) -> memoryview:
    store = types_for(kind)
    types: dict[str, Any] = store.types
    time = types["builtin_interfaces/msg/Time"]
    header = types["std_msgs/msg/Header"](stamp=time(sec=at // 10**9, nanosec=at % 10**9), frame_id="base")
    if frame is not None:
        item = types["tpgmm_msgs/msg/TaskFrame"](
            name=frame.name,
            status=frame.status,
            confidence=frame.confidence,
            stamp=time(sec=0, nanosec=0),
            rows=frame.rows,
            cols=frame.cols,
            a=np.array(frame.a),
            b=np.array(frame.b),
            pose_covariance=np.array(frame.pose_covariance),
        )
        return store.serialize_cdr(types[kind](header=header, frames=[item]), kind)
    assert pose is not None
    x, y, z, *turned = map(float, pose)
    shown = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z),
        orientation=types["geometry_msgs/msg/Quaternion"](**dict(zip(("x", "y", "z", "w"), turned, strict=True))),
    )
    return store.serialize_cdr(types[kind](header=header, pose=shown), kind)
