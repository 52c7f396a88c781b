# SPDX-License-Identifier: Apache-2.0
"""What was on the topics while the demo ran."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from tpgmm_core.common.types import Array
from tpgmm_msgs.msg import Reference, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.recordings.bag_recorder import RECORD
from tpgmm_ros.runtime.rclpy_workarounds import waiting
from tpgmm_ros.task.task_file import Task

MessageT = TypeVar("MessageT")


@dataclass(frozen=True, slots=True)
class Series:
    """Values (T, ...) at stamps (T,), ns, increasing."""

    stamps_ns: NDArray[np.int64]
    values: Array

    def since(self, stamp_ns: int) -> Series:
        """What is not older than a stamp, ns."""
        chosen = self.stamps_ns >= stamp_ns
        return Series(self.stamps_ns[chosen], self.values[chosen])

    def times(self, origin_ns: int) -> Array:
        """Times (T,) in s since a stamp."""
        return np.asarray(1e-9 * (self.stamps_ns - origin_ns))


class RunRecord:
    """Records torques, references, hand poses, frames and diagnostics of the running graph.

    What comes waits in the subscriptions' queues until ``poll`` takes it, and is kept as bytes until it is asked for:
    an event for each message of a 1 kHz stream, and reading it, would take the cores from those who need them.

    Parameters
    ----------
    node
        subscribes; an executor must not serve it
    task
        the movement's topic and the frames
    joints
        names of the robot's joints, the order of the recorded torques
    with_other_hosts
        False: torques and poses of the hand alone, which a robot's own host publishes
    """

    def __init__(self, node: Node, task: Task, joints: list[str], with_other_hosts: bool = True) -> None:
        self.joints = joints
        self._frame_names = list(task.frames)
        self._raw: dict[type, list[bytes]] = {}
        self._subscriptions: list[tuple[Subscription, list[bytes]]] = []
        self._subscribe(node, JointState, "joint_torques")
        self._subscribe(node, PoseStamped, task.movement)
        if not with_other_hosts:
            return
        self._subscribe(node, Reference, "reference")
        self._subscribe(node, TaskParameters, "task_parameters")
        self._subscribe(node, DiagnosticArray, "/diagnostics")

    def _subscribe(self, node: Node, kind: type, topic: str) -> None:
        subscription = node.create_subscription(kind, topic, lambda _: None, RECORD, raw=True)
        self._subscriptions.append((subscription, self._raw.setdefault(kind, [])))

    def poll(self) -> None:
        """Take what has come; call it at least every second, the queues are finite."""
        for subscription, rows in self._subscriptions:
            rows.extend(waiting(subscription, raw=True))

    def _messages(self, kind: type[MessageT]) -> Iterator[MessageT]:
        return (deserialize_message(data, kind) for data in self._raw[kind])

    def first_reference_ns(self) -> int | None:
        """Stamp of the first reference: the start of the movement."""
        first = next((message for message in self._messages(Reference) if message.gaussian.mean), None)
        return None if first is None else conversions.time_to_ns(first.header.stamp)

    def hand_is_known(self) -> bool:
        """Whether the hand's pose came at least once."""
        self.poll()
        return bool(self._raw[PoseStamped])

    def says(self, node: str, key: str) -> bool:
        """Whether the last diagnostics of a node hold a key."""
        self.poll()
        rows = self.diagnostics(node, 0)
        return bool(rows) and key in rows[-1]

    def digest(self, start_ns: int, duration: float) -> str:
        """Of all torques and poses of the hand within a time (ns, s): the same for the same numbers, bit by bit."""
        digest = hashlib.sha256()
        for series in (self.torque(), self.hand()):
            stamps, first = np.unique(series.stamps_ns, return_index=True)  # some are sent again
            chosen = (stamps >= start_ns) & (stamps <= start_ns + 1e9 * duration)
            digest.update(stamps[chosen].tobytes())
            digest.update(np.ascontiguousarray(series.values[first[chosen]]).tobytes())
        return digest.hexdigest()

    def torque(self) -> Series:
        """Torques (T, nv), N m."""
        reader = JointReader(self.joints)
        return _series((message, reader.read(message, "effort")[0]) for message in self._messages(JointState))

    def reference(self) -> Series:
        """Means of the references (T, 7)."""
        # in lockstep, references come also while nothing is reproduced, and are empty then
        moving = (message for message in self._messages(Reference) if message.gaussian.mean)
        return _series((message, np.array(message.gaussian.mean)) for message in moving)

    def hand(self) -> Series:
        """Poses of the hand (T, 7)."""
        return _series((message, conversions.pose_to_array(message.pose)) for message in self._messages(PoseStamped))

    def frames(self) -> dict[str, Series]:
        """Status and confidence (T, 2) of each frame."""
        rows: dict[str, list[tuple[TaskParameters, Array]]] = {name: [] for name in self._frame_names}
        for message in self._messages(TaskParameters):
            for item in message.frames:
                rows[item.name].append((message, np.array([item.status, item.confidence])))
        return {name: _series(values) for name, values in rows.items()}

    def observations(self, since_ns: int) -> dict[str, int]:
        """How many observations of each frame came through to the task parameters since a stamp."""
        stamps: dict[str, set[int]] = {name: set() for name in self._frame_names}
        for message in self._messages(TaskParameters):
            for item in message.frames:
                stamps[item.name].add(conversions.time_to_ns(item.stamp))
        return {name: sum(stamp >= since_ns for stamp in seen) for name, seen in stamps.items()}

    def diagnostics(self, node: str, since_ns: int) -> list[dict[str, str]]:
        """What a node has published about itself since a stamp, oldest first; without any since then, the last one."""
        rows = [
            (conversions.time_to_ns(message.header.stamp), {item.key: item.value for item in status.values})
            for message in self._messages(DiagnosticArray)
            for status in message.status
            if status.name == node
        ]
        return [values for stamp, values in rows if stamp >= since_ns] or [values for _, values in rows[-1:]]


def _series(rows: Iterable[tuple[Any, Array]]) -> Series:
    listed = [(conversions.time_to_ns(message.header.stamp), values) for message, values in rows]
    return Series(np.array([stamp for stamp, _ in listed], dtype=np.int64), np.array([values for _, values in listed]))
