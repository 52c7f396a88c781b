# SPDX-License-Identifier: Apache-2.0
"""What was on the topics while the demo ran."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from tpgmm_core.tracking import FrameStatus
from tpgmm_msgs.msg import Reference, TaskParameters

from tpgmm_ros import conversions
from tpgmm_ros.bag_recorder import RECORD
from tpgmm_ros.conversions import JointReader
from tpgmm_ros.pick_place import Array
from tpgmm_ros.qos import EVENTS, LATCHED
from tpgmm_ros.task import Task


@dataclass(frozen=True, slots=True)
class Series:
    """Values (T, ...) at stamps (T,), ns, increasing."""

    stamps_ns: NDArray[np.int64]
    values: Array

    def since(self, stamp_ns: int) -> Series:
        chosen = self.stamps_ns >= stamp_ns
        return Series(self.stamps_ns[chosen], self.values[chosen])

    def times(self, origin_ns: int) -> Array:
        """Times (T,) in s since a stamp."""
        return 1e-9 * (self.stamps_ns - origin_ns)


class Recording:
    """Records torques, references, hand poses, frames and diagnostics of the running graph.

    Args:
        node: subscribes.
        task: the movement's topic and the frames.
        joints: names of the robot's joints, the order of the recorded torques.
    """

    def __init__(self, node: Node, task: Task, joints: list[str]) -> None:
        self.joints = joints
        self._reader = JointReader(joints)
        self._rows: dict[str, list[tuple[int, Array]]] = {"torque": [], "reference": [], "hand": []}
        self._frames: dict[str, list[tuple[int, Array]]] = {name: [] for name in task.frames}
        self.diagnostics: dict[str, list[tuple[int, dict[str, str]]]] = {}
        node.create_subscription(JointState, "joint_torques", self._take_torque, RECORD)
        node.create_subscription(Reference, "reference", self._take_reference, RECORD)
        node.create_subscription(PoseStamped, task.movement, self._take_hand, RECORD)
        node.create_subscription(TaskParameters, "task_parameters", self._take_frames, LATCHED)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, EVENTS)

    def first_reference_ns(self) -> int | None:
        """Stamp of the first reference: the start of the movement."""
        return self._rows["reference"][0][0] if self._rows["reference"] else None

    def torque(self) -> Series:
        """Torques (T, nv), N m."""
        return _series(self._rows["torque"])

    def reference(self) -> Series:
        """Means of the references (T, 7)."""
        return _series(self._rows["reference"])

    def hand(self) -> Series:
        """Poses of the hand (T, 7)."""
        return _series(self._rows["hand"])

    def frames(self) -> dict[str, Series]:
        """Status and confidence (T, 2) of each frame."""
        return {name: _series(rows) for name, rows in self._frames.items()}

    def diagnostic(self, node: str, since_ns: int) -> list[dict[str, str]]:
        """What a node has published about itself since a stamp, oldest first; without one since then, the last one."""
        rows = self.diagnostics.get(node, [])
        return [values for stamp, values in rows if stamp >= since_ns] or [values for _, values in rows[-1:]]

    def _take_torque(self, message: JointState) -> None:
        self._rows["torque"].append(
            (conversions.time_to_ns(message.header.stamp), self._reader.read(message, "effort")[0])
        )

    def _take_reference(self, message: Reference) -> None:
        # Only the mean: converting every Gaussian of a 1 kHz stream would take the cores from those who need them.
        self._rows["reference"].append(
            (conversions.time_to_ns(message.header.stamp), np.array(message.gaussian.mean))
        )

    def _take_hand(self, message: PoseStamped) -> None:
        self._rows["hand"].append(
            (conversions.time_to_ns(message.header.stamp), conversions.pose_to_array(message.pose))
        )

    def _take_frames(self, message: TaskParameters) -> None:
        stamp = conversions.time_to_ns(message.header.stamp)
        for item in message.frames:
            confidence = 0.0 if item.status == FrameStatus.MISSING else item.confidence
            self._frames[item.name].append((stamp, np.array([item.status, confidence])))

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        stamp = conversions.time_to_ns(message.header.stamp)
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self.diagnostics.setdefault(status.name, []).append((stamp, values))


def _series(rows: list[tuple[int, Array]]) -> Series:
    return Series(np.array([stamp for stamp, _ in rows], dtype=np.int64), np.array([value for _, value in rows]))
