# SPDX-License-Identifier: Apache-2.0
"""Topics to a rosbag2 recording (MCAP, zstd), as they come."""

from __future__ import annotations

import contextlib
import functools
import shutil
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

from tpgmm_ros.task.task_file import Task

#: Nothing that comes while the disk is busy is to be lost, whatever the publisher promises.
RECORD = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def topics_of(task: Task) -> dict[str, type]:
    """The topics that a recording of a task holds."""
    return {task.movement: PoseStamped, **dict.fromkeys(task.topics.values(), PoseStamped), "joint_states": JointState}


class BagRecorder:
    """Records topics into one bag, from ``with`` to its end.

    The bag grows in ``.partial`` beside its final place and is put there when it is complete: a recording that was cut
    short by an error never looks like a whole one, and stays in ``.partial``. An existing bag is never overwritten.

    Parameters
    ----------
    node
        the node that subscribes
    path
        the bag's directory; must not exist yet
    topics
        message classes by topic name (as the node resolves it)
    keep_every
        keep only every n-th message of a topic, for topics that come faster than they are needed

    Raises
    ------
    FileExistsError
        there is something at ``path`` already.
    """

    def __init__(
        self, node: Node, path: Path, topics: Mapping[str, type], keep_every: Mapping[str, int] | None = None
    ) -> None:
        if path.exists():
            raise FileExistsError(f"{path} exists; recordings are not overwritten: move it, or give another path")
        self.path = path
        self.counts = dict.fromkeys(topics, 0)
        self._last: dict[str, bytes] = {}
        self._node = node
        self._topics = dict(topics)
        self._keep_every = dict(keep_every or {})
        # rosbag2 names the files after the directory, so the unfinished bag has its final name elsewhere.
        self._is_over = False
        self._partial = path.parent / ".partial" / path.name

    def __enter__(self) -> BagRecorder:
        shutil.rmtree(self._partial, ignore_errors=True)
        self._partial.parent.mkdir(parents=True, exist_ok=True)
        self._writer = Writer(self._partial, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()
        store = get_typestore(Stores.ROS2_JAZZY)
        self._subscriptions = []
        for topic, kind in self._topics.items():
            package = kind.__module__.partition(".")[0]
            connection = self._writer.add_connection(
                self._node.resolve_topic_name(topic), f"{package}/msg/{kind.__name__}", typestore=store
            )
            write = functools.partial(self._write, topic, connection)
            self._subscriptions.append(self._node.create_subscription(kind, topic, write, RECORD, raw=True))
        return self

    def _write(self, topic: str, connection: Connection, data: bytes) -> None:
        if self._is_over:  # an executor may still have what came before the subscription was taken away
            return
        if data == self._last.get(topic):
            return  # sent again because an answer was missing, stamp and all
        self._last[topic] = data
        if self.counts[topic] % self._keep_every.get(topic, 1) == 0:
            self._writer.write(connection, self._node.get_clock().now().nanoseconds, data)
        self.counts[topic] += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_over = True
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._writer.close()
        if kind is None:
            self._partial.rename(self.path)
            with contextlib.suppress(OSError):  # other unfinished recordings may lie there
                self._partial.parent.rmdir()
