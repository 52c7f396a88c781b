# SPDX-License-Identifier: Apache-2.0
"""endpoint_poses: joint states in, poses of the end points out, for robots whose drivers publish joints alone."""

from __future__ import annotations

import sys
import time

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from tpgmm_core.observation.streams import Stamp
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.broadcasting import RobotBroadcaster
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.nodes.joint_states import BROADCAST_ROBOT, SPREAD, Heard, JointStateStream
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters

PARAMETERS = [
    Declared("robot_file", "", "Robot file (YAML): URDF, end points, limits", fixed=True),
    Declared("pose_rate", 100.0, "Rate of end point poses, at most that of joint states, Hz", 1.0, 1000.0, fixed=True),
    BROADCAST_ROBOT,
    SPREAD,
]


class EndpointPosesNode(Node):
    """Publishes where the end points are for the joint states that come."""

    def __init__(self) -> None:
        super().__init__("endpoint_poses")
        parameters = Parameters(self, PARAMETERS)
        self.robot = RobotModel.from_file(parameters.file("robot_file"))
        self._data = self.robot.create_data()
        self._period_ns = round(1e9 / parameters["pose_rate"])
        self._due_ns = 0
        self._poses = {
            name: self.create_publisher(PoseStamped, f"endpoint/{name}/pose", STREAM) for name in self.robot.endpoints
        }
        shows = parameters[BROADCAST_ROBOT.name]
        self._shown = RobotBroadcaster(self, self.robot) if shows else None
        self._joint_states = JointStateStream(
            self, "joint_states", self._take, self.robot.joint_names, ("position",), parameters[SPREAD.name]
        )
        self.monitor = Monitor(self, self._status, parameters["pose_rate"], self._joint_states.silence)

    def _take(self, heard: Heard) -> None:
        start = time.perf_counter()
        # by the stamps, on a grid of the period; further ahead than a period: time jumped backwards
        if heard.kind is Stamp.REPEATED or 0 < self._due_ns - heard.stamp_ns <= self._period_ns:
            return
        stamp_ns, (q,) = heard.stamp_ns, heard.values
        self._due_ns = stamp_ns - stamp_ns % self._period_ns + self._period_ns
        self.monitor.tick(stamp_ns)
        self._data.update(q)
        for name, publisher in self._poses.items():
            publisher.publish(conversions.pose_stamped(self._data.pose(name), stamp_ns, self.robot.base_frame))
        if self._shown is not None:
            self._shown.send(self._data, stamp_ns)
        self.monitor.done += 1
        self.monitor.step.add(time.perf_counter() - start)

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        return DiagnosticStatus.OK, f"poses of {', '.join(self._poses)}", {}


def main() -> int:
    """Run the node; returns the exit status."""
    return run(EndpointPosesNode)


if __name__ == "__main__":
    sys.exit(main())
