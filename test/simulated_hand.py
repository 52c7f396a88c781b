# SPDX-License-Identifier: Apache-2.0
"""A simulated Baxter whose time the test controls: publishes a joint state, waits for the torques that answer it."""

from __future__ import annotations

import time

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ALL, ROBOT_FILE, SECOND
from ros_testing import RunningProcess, spin_until
from tpgmm_core import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import STREAM

ROBOT = RobotModel.from_file(ROBOT_FILE)
NAMES = list(ROBOT.joint_names)
TICK_NS = SECOND // 1000
POSE = Manifold.parse("R3 x S3")
DIMENSIONS = ("x", "y", "z", "qx", "qy", "qz", "qw")


def pose_reference(pose: np.ndarray, stamp_ns: int, deviation: float = 0.01) -> ReferenceMessage:
    """A reference that stands still at a pose, with a standard deviation in m, and ten times as many rad."""
    covariance = np.diag(np.repeat([deviation**2, (10.0 * deviation) ** 2], 3))
    reference = Reference(0.5, Gaussian(pose, covariance, POSE), 0.0, (), np.ones(1), ("object",))
    return conversions.reference_message(reference, DIMENSIONS, stamp_ns, ROBOT.base_frame)


class SimulatedHand:
    """Baxter on the other side of `joint_states` and `joint_torques`; each `tick` is `ms` milliseconds of its time."""

    def __init__(self, node: Node, process: RunningProcess, ms: int = 1) -> None:
        self.node, self.process, self._ms = node, process, ms
        self.simulator = RobotSimulator(ROBOT)
        self.stamp_ns = SECOND
        self.torques: list[np.ndarray] = []
        #: What pushes its links, (6,) N and N m by their names.
        self.wrenches: dict[str, np.ndarray] = {}
        self._data = ROBOT.create_data()
        self._reader = JointReader(NAMES)
        self._answers: dict[int, np.ndarray] = {}
        self.states = node.create_publisher(JointState, "joint_states", STREAM)
        self.references = node.create_publisher(ReferenceMessage, "reference", STREAM)
        node.create_subscription(JointState, "joint_torques", self._take, ALL)

    @property
    def pose(self) -> np.ndarray:
        """Pose (7,) of the left hand."""
        self._data.update(self.simulator.state.q)
        return self._data.pose("left").copy()

    def state(self) -> JointState:
        """The joint state of this moment."""
        state = self.simulator.state
        return conversions.joint_state_message(NAMES, self.stamp_ns, state.q, state.v, state.tau)

    def answered(self) -> bool:
        """Whether the state of this moment has been answered by torques."""
        return self.stamp_ns in self._answers

    def tick(self, reference: ReferenceMessage | None = None, state: JointState | None = None) -> np.ndarray:
        """Some milliseconds: reference and state out, torques (nv,) in, which then move the robot."""
        self.stamp_ns += self._ms * TICK_NS
        message = self.state() if state is None else state
        message.header.stamp = conversions.time_from_ns(self.stamp_ns)
        due = 0.0

        def answered() -> bool:
            nonlocal due
            if not self.answered() and time.monotonic() >= due:  # best effort may lose a message
                due = time.monotonic() + 0.2
                if reference is not None:
                    self.references.publish(reference)
                self.states.publish(message)
            return self.answered()

        spin_until(self.node, answered, message="torques", processes=(self.process,))
        tau = self._answers[self.stamp_ns]
        for _ in range(self._ms):
            self.simulator.step(tau, self.wrenches)
        self.torques.append(tau)
        return tau

    def offer(self, state: JointState) -> None:
        """Publish a state with the next stamp and wait for nothing."""
        self.stamp_ns += TICK_NS
        state.header.stamp = conversions.time_from_ns(self.stamp_ns)
        self.states.publish(state)

    def _take(self, message: JointState) -> None:
        self._answers[conversions.time_to_ns(message.header.stamp)] = self._reader.read(message, "effort")[0]
