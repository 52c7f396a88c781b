# SPDX-License-Identifier: Apache-2.0
"""Real bags with synthetic contents, for tests: written by rosbags, in every storage that it writes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tpgmm_core.geometry import quaternion

Storage = Literal["mcap", "sqlite3", "ros1"]
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"

START_S = 1_700_000_000.0
"""When the recordings begin, in s since 1970."""

REACH_TASK = """\
name: reach
base_frame: base
movement: endpoint/pose
endpoint: left
frames:
  object: {topic: object/pose}
  robot: {pose: [0, 0, 0, 0, 0, 0, 1]}
model: {n_components: 5, reg_covar: 1.0e-4, max_iter: 50}
"""


@dataclass
class Topic:
    """Messages of one topic. `recorded` and `stamps` are in s after START_S; None is stamps of zero.

    They are written in the order of `written`, s: None is that of `recorded`.
    """

    poses: NDArray[np.float64]
    recorded: NDArray[np.float64]
    stamps: NDArray[np.float64] | None = field(default_factory=lambda: np.empty(0))
    frame_id: str = "base"
    written: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        self.poses = np.atleast_2d(np.asarray(self.poses, float))
        self.recorded = np.atleast_1d(np.asarray(self.recorded, float))
        if self.stamps is not None and not len(self.stamps):
            self.stamps = self.recorded


def reach(seed: int, samples: int = 100, duration: float = 5.0) -> dict[str, Topic]:
    """The hand goes from where it always starts to 10 cm above an object, and turns as that is turned."""
    random = np.random.default_rng(seed)
    times = np.linspace(0.0, duration, samples)
    goal = np.array([0.7, 0.0, 0.1]) + random.uniform(-0.2, 0.2, 3)
    turned = quaternion.exp([0.0, 0.0, random.uniform(-0.8, 0.8)])
    s = times / duration
    blend = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]  # minimum jerk
    start = np.array([0.4, 0.4, 0.4])
    hand = np.hstack(
        [
            start + blend * (goal + [0.0, 0.0, 0.1] - start),
            quaternion.slerp(np.tile(quaternion.IDENTITY, (samples, 1)), turned, blend[:, 0]),
        ]
    )
    hand[:, :3] += random.normal(0.0, 1e-3, (samples, 3))
    return {
        "/endpoint/pose": Topic(hand, times),
        "/object/pose": Topic(np.tile(np.hstack([goal, turned]), (samples, 1)), times),
    }


def write_bag(path: Path, topics: Mapping[str, Topic], storage: Storage = "mcap") -> Path:
    """Write a bag with PoseStamped topics."""

    def order(message: tuple[float, str, int]) -> float:
        at, name, i = message
        written = topics[name].written
        return at if written is None else float(written[i])

    messages = sorted(
        ((at, name, i) for name, topic in topics.items() for i, at in enumerate(topic.recorded)), key=order
    )
    if storage == "ros1":
        return _write_ros1(path, topics, messages)
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        connections = {name: writer.add_connection(name, POSE_STAMPED, typestore=typestore) for name in topics}
        for at, name, i in messages:
            message = _message(typestore, topics[name], i)
            writer.write(connections[name], _nanoseconds(at), typestore.serialize_cdr(message, POSE_STAMPED))
    return path


def _write_ros1(path: Path, topics: Mapping[str, Topic], messages: Sequence[tuple[float, str, int]]) -> Path:
    typestore = get_typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(path) as writer:
        connections = {name: writer.add_connection(name, POSE_STAMPED, typestore=typestore) for name in topics}
        for at, name, i in messages:
            message = _message(typestore, topics[name], i, seq=i)
            writer.write(connections[name], _nanoseconds(at), typestore.serialize_ros1(message, POSE_STAMPED))
    return path


def _nanoseconds(seconds: float) -> int:
    return int(START_S) * 1_000_000_000 + round(seconds * 1e9)


def _message(typestore: Any, topic: Topic, i: int, **header: int) -> Any:
    types = typestore.types
    ns = 0 if topic.stamps is None else _nanoseconds(topic.stamps[i])
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)
    return types[POSE_STAMPED](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=topic.frame_id, **header),
        pose=_pose(types, topic.poses[i]),
    )


def _pose(types: Any, numbers: NDArray[np.float64]) -> Any:
    x, y, z, qx, qy, qz, qw = map(float, numbers)
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z),
        orientation=types["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
    )


def write_pose_arrays(
    path: Path, arrays: Sequence[NDArray[np.float64]], topic: str = "/demo", frame_id: str = "base", ros1: bool = True
) -> Path:
    """Write a bag with PoseArrays (T, 7) without stamps on one topic."""
    typestore = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    types = typestore.types
    with Ros1Writer(path) if ros1 else Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, POSE_ARRAY, typestore=typestore)
        for i, poses in enumerate(arrays):
            stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **({"seq": i} if ros1 else {}))
            message = types[POSE_ARRAY](header=header, poses=[_pose(types, numbers) for numbers in poses])
            serialize = typestore.serialize_ros1 if ros1 else typestore.serialize_cdr
            writer.write(connection, _nanoseconds(i), serialize(message, POSE_ARRAY))
    return path
