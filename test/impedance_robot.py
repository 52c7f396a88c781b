# SPDX-License-Identifier: Apache-2.0
"""An arm behind the topics of crisp_controllers as its own process: a Cartesian impedance controller, and its robot.

    python impedance_robot.py [--slower=N] ROBOT_FILE ENDPOINT

It takes `target_pose` and `target_stiffness`, goes to the last pose that it has been told for ever, with the error cut
and torques that change no faster than that controller lets them, and pulls its joints back to where they were at the
start as far as the hand does not move by that. It publishes `joint_states` at 100 Hz.
"""

from __future__ import annotations

import sys

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Float64MultiArray

from interfaces.contract import broken_by_stiffness, broken_by_target
from interfaces.stand_in import StandIn, run, slower
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import COMMANDS

#: Of joint states, and of the controller and the simulation, s.
PERIOD, TIME_STEP = 0.01, 0.002
#: Before it is told a stiffness, N/m and N m/rad.
STIFFNESS = np.repeat([500.0, 30.0], 3)
#: The error of the pose that counts at most, m and rad.
CLIP = np.repeat([0.1, 0.5], 3)
#: Largest change of a torque, N m/s.
TORQUE_RATE = 500.0
#: Of the pull back to the joints of the start, N m/rad and N m s/rad; at most so many N m.
POSTURE_STIFFNESS, POSTURE_DAMPING, POSTURE_TORQUE = 1.0, 2.0, 5.0
#: A target moves that is so far from the one before, m and rad.
MOVES = 1e-5, 1e-4
#: So many steps are caught up with at most after a pause of the process.
MOST_STEPS = 100


class ImpedanceRobot(StandIn):
    """See the module."""

    def __init__(self, robot: RobotModel, endpoint: str, slower: float) -> None:
        joints = robot.indices(robot.endpoints[endpoint].joints)
        super().__init__("impedance_robot", robot, [robot.joint_names[i] for i in joints], slower)
        self.endpoint, self.joints = endpoint, joints
        self.simulator = RobotSimulator(robot, TIME_STEP)
        self.data = robot.create_data()
        self.data.update(robot.home)
        self.target, self.stiffness = self.data.pose(endpoint), STIFFNESS
        self.torque = self.data.gravity(robot.home)
        self.begun: float | None = None
        self.told_ns = self.now_ns()
        self.create_subscription(PoseStamped, "target_pose", self.take, COMMANDS)
        self.create_subscription(Float64MultiArray, "target_stiffness", self.take_stiffness, COMMANDS)
        self.every(PERIOD, self.step)

    def take(self, message: PoseStamped) -> None:
        if (count := self.count_publishers("target_pose")) > 1:
            self.violate(f"publishers: {count} of target_pose, which is then not heard")
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        since, self.told_ns = 1e-9 * (stamp_ns - self.told_ns), stamp_ns
        self.violate(*broken_by_target(message, self.robot.base_frame, self.target, self.now_ns(), since))
        target = conversions.pose_to_array(message.pose)
        way, turn = pose_error(target, self.target)
        self.hear(way > MOVES[0] or turn > MOVES[1])
        self.target = target

    def take_stiffness(self, message: Float64MultiArray) -> None:
        if broken := broken_by_stiffness(message):
            self.violate(*broken)
        else:
            self.stiffness = np.array(message.data)

    def step(self) -> None:
        self.begun = self.now() if self.begun is None else self.begun
        late = self.now() - self.begun - self.simulator.state.time
        steps = min(MOST_STEPS, max(1, round(late / TIME_STEP)))
        self.begun += max(0.0, late - steps * TIME_STEP - PERIOD)  # of a longer pause, time is let go
        for _ in range(steps):
            self.simulator.step(self.torques())
        state = self.simulator.state
        self.publish_state(state.q[self.joints], state.v[self.joints])

    def torques(self) -> np.ndarray:
        q, v = self.simulator.state.q, self.simulator.state.v
        self.data.update(q, v)
        J = self.data.jacobian(self.endpoint)[:, self.joints]
        error = np.clip(POSE.log(self.data.pose(self.endpoint), self.target), -CLIP, CLIP)
        damping = 2.0 * np.sqrt(self.stiffness)
        task = J.T @ (self.stiffness * error - damping * (J @ v[self.joints]))
        away = (self.robot.home - q)[self.joints]
        pull = POSTURE_STIFFNESS * away - POSTURE_DAMPING * v[self.joints]
        free = np.eye(len(self.joints)) - np.linalg.pinv(J, rcond=1e-3) @ J
        wanted = self.data.nonlinear_effects(q, v).copy()
        wanted[self.joints] += task + np.clip(free @ pull, -POSTURE_TORQUE, POSTURE_TORQUE)
        change = TORQUE_RATE * TIME_STEP
        self.torque = self.torque + np.clip(wanted - self.torque, -change, change)
        return self.torque


def main() -> None:
    words = sys.argv[1:]
    factor = slower(words)
    robot_file, endpoint = words
    rclpy.init()
    run(ImpedanceRobot(RobotModel.from_file(robot_file), endpoint, factor))


if __name__ == "__main__":
    main()
