# SPDX-License-Identifier: Apache-2.0
"""Messages of every source of poses, as rosbags has them, bags of them, and tasks that name the sources."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from synthetic_bags import REACH_TASK, START_S
from tpgmm_ros.task.task_file import Task

DETECTIONS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}
TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
for name, definition in DETECTIONS.items():
    TYPESTORE.register(get_types_from_msg(definition, name))
TYPES = TYPESTORE.types
Message = tuple[float, str, str, Any]
COVARIANCE = np.diag([1e-4, 4e-4, 1e-4, 1e-2, 1e-2, 1e-2])


def header(seconds: float, frame_id: str = "base") -> Any:
    ns = int(START_S) * 10**9 + round(seconds * 1e9)
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def vector(kind: str, numbers: NDArray[np.float64]) -> Any:
    return TYPES[f"geometry_msgs/msg/{kind}"](*map(float, numbers))


def pose_of(numbers: NDArray[np.float64]) -> Any:
    return TYPES["geometry_msgs/msg/Pose"](
        position=vector("Point", numbers[:3]), orientation=vector("Quaternion", numbers[3:])
    )


def with_covariance(numbers: NDArray[np.float64]) -> Any:
    return TYPES["geometry_msgs/msg/PoseWithCovariance"](pose=pose_of(numbers), covariance=COVARIANCE.ravel())


def pose_stamped(numbers: NDArray[np.float64], at: float, frame_id: str = "base") -> Any:
    return TYPES["geometry_msgs/msg/PoseStamped"](header=header(at, frame_id), pose=pose_of(numbers))


def transform(numbers: NDArray[np.float64], at: float, child: str, parent: str = "base") -> Any:
    moved = TYPES["geometry_msgs/msg/Transform"](
        translation=vector("Vector3", numbers[:3]), rotation=vector("Quaternion", numbers[3:])
    )
    return TYPES["geometry_msgs/msg/TransformStamped"](header=header(at, parent), child_frame_id=child, transform=moved)


def odometry(numbers: NDArray[np.float64], at: float) -> Any:
    zero = np.zeros(3)
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector("Vector3", zero), angular=vector("Vector3", zero))
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(at),
        child_frame_id="hand",
        pose=with_covariance(numbers),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36)),
    )


def detections(at: float, **seen: tuple[float, NDArray[np.float64]]) -> Any:
    """Detections of classes with scores; the tracking id is the class with an underscore."""
    found = []
    for kind, (score, numbers) in seen.items():
        hypothesis = TYPES["vision_msgs/msg/ObjectHypothesis"](class_id=kind.split("_")[0], score=score)
        result = TYPES["vision_msgs/msg/ObjectHypothesisWithPose"](hypothesis=hypothesis, pose=with_covariance(numbers))
        box = TYPES["vision_msgs/msg/BoundingBox3D"](center=pose_of(numbers), size=vector("Vector3", np.ones(3)))
        found.append(TYPES["vision_msgs/msg/Detection3D"](header=header(at, ""), results=[result], bbox=box, id=kind))
    return TYPES["vision_msgs/msg/Detection3DArray"](header=header(at), detections=found)


def write(path: Path, messages: list[Message]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=TYPESTORE)
            for topic, kind in dict.fromkeys((topic, kind) for _, topic, kind, _ in messages)
        }
        for at, topic, kind, message in sorted(messages, key=lambda item: item[0]):
            ns = int(START_S) * 10**9 + round(at * 1e9)
            writer.write(connections[topic], ns, TYPESTORE.serialize_cdr(message, kind))
    return path


def of_type(kind: str, topic: str, poses: NDArray[np.float64], times: NDArray[np.float64], child: str) -> list[Message]:
    """The poses of one thing, as messages of a type."""
    if kind == "tf":
        tf = TYPES["tf2_msgs/msg/TFMessage"]
        return [
            (t, "/tf", "tf2_msgs/msg/TFMessage", tf(transforms=[transform(pose, t, child)]))
            for pose, t in zip(poses, times, strict=True)
        ]
    make = {
        "geometry_msgs/PoseStamped": pose_stamped,
        "geometry_msgs/TransformStamped": lambda pose, t: transform(pose, t, child),
        "geometry_msgs/PoseWithCovarianceStamped": lambda pose, t: TYPES["geometry_msgs/msg/PoseWithCovarianceStamped"](
            header=header(t), pose=with_covariance(pose)
        ),
        "nav_msgs/Odometry": odometry,
        "vision_msgs/Detection3DArray": lambda pose, t: detections(t, **{child: (0.9, pose), "other": (1.0, -pose)}),
    }[kind]
    return [(t, topic, kind.replace("/", "/msg/"), make(pose, t)) for pose, t in zip(poses, times, strict=True)]


def task_with(**entries: Any) -> Task:
    """The reach, with other entries of the frame `object` and of the recorded movement."""
    task = yaml.safe_load(REACH_TASK)
    if "object" in entries:
        task["frames"]["object"] = entries["object"]
    if "movement" in entries:
        task["recordings"] = {"movement": entries["movement"]}
    return Task.from_text(yaml.safe_dump(task))
