# SPDX-License-Identifier: Apache-2.0
"""A position-controlled robot as its own process: a joint_trajectory_controller that checks what it is sent.

    python position_robot.py [--slower=N] ROBOT_FILE JOINT...

It takes `joint_trajectory_controller/joint_trajectory` (reliable) and goals of the action
`joint_trajectory_controller/follow_joint_trajectory`, each of which takes the place of the one before, for the joints
in the order that it is given. It goes along cubic splines, each from where it is told to be at that time. It publishes
`joint_states` at 125 Hz, with the joints in another order, as drivers do. `robot_mode` (std_msgs/String) takes "stuck"
(it does not move, as after an emergency stop; a goal is aborted once its tolerance is exceeded), "silent" (no joint
states), "refusing" (each goal), "deaf" (goals are not answered) and "well". What breaks the contract of the interface
is on `violations`: see `interfaces.contract`.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from interfaces.contract import broken_by_trajectory
from interfaces.stand_in import KEPT, StandIn, run, slower
from tpgmm_core.robot.model import RobotModel

RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
#: Period of its joint states, s.
PERIOD = 0.008
#: A goal is aborted where a joint is farther from its trajectory, or than the goal allows, rad.
OWN_TOLERANCE = 0.1
#: A deaf one answers after this, s.
DEAF = 2.0


class PositionRobot(StandIn):
    """See the module."""

    def __init__(self, robot: RobotModel, order: list[str], slower: float) -> None:
        super().__init__("position_robot", robot, order, slower)
        self.joints = robot.indices(order)
        self.q, self.v = robot.home[self.joints], np.zeros(len(order))
        #: times (s), positions and velocities that it goes through
        self.way: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.mode = "well"
        self.create_subscription(JointTrajectory, "joint_trajectory_controller/joint_trajectory", self.take, RELIABLE)
        self.create_subscription(String, "robot_mode", self.take_mode, KEPT)
        self.goal: ServerGoalHandle | None = None
        self.tolerance = np.full(len(order), np.inf)
        self.server = ActionServer(
            self,
            FollowJointTrajectory,
            "joint_trajectory_controller/follow_joint_trajectory",
            execute_callback=lambda _: None,  # goals are executed by `end`
            goal_callback=self.judge,
            handle_accepted_callback=self.begin,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self.every(PERIOD, self.step)

    def take_mode(self, message: String) -> None:
        self.mode = message.data
        if self.mode == "well":  # let go: it goes on from where it is, as its controller has been told last
            self.way = [(self.now(), self.q, np.zeros(len(self.order))), *self.way[-1:]]

    def judge(self, goal: FollowJointTrajectory.Goal) -> GoalResponse:
        if self.mode == "deaf":
            time.sleep(DEAF)
        names, tolerances = zip(*[(item.name, item.position) for item in goal.path_tolerance], strict=True)
        if list(names) != self.order or min(tolerances) <= 0.0:
            self.violate(f"tolerances: {tolerances} of {names}")
        return GoalResponse.REJECT if self.mode == "refusing" else GoalResponse.ACCEPT

    def begin(self, goal: ServerGoalHandle) -> None:
        self.end(FollowJointTrajectory.Result.INVALID_GOAL, "another goal takes its place")
        self.goal = goal
        self.tolerance = np.array([min(OWN_TOLERANCE, item.position) for item in goal.request.path_tolerance])
        self.take(goal.request.trajectory)

    def end(self, code: int, text: str) -> None:
        """The goal that goes on ends, if there is one."""

        def result(goal: ServerGoalHandle) -> FollowJointTrajectory.Result:
            if goal.is_cancel_requested:
                goal.canceled()
                return FollowJointTrajectory.Result()
            if code == FollowJointTrajectory.Result.SUCCESSFUL:
                goal.succeed()
            else:
                goal.abort()
            return FollowJointTrajectory.Result(error_code=code, error_string=text)

        if self.goal is not None:
            self.goal.execute(result)
        self.goal = None

    def watch_goal(self) -> None:
        """It ends canceled, too far from where it should be, or at the end of its trajectory."""
        if self.goal is None:
            return
        told, _ = self.told(self.now())
        if self.goal.is_cancel_requested or (np.abs(told - self.q) > self.tolerance).any():
            joint = self.order[int(np.argmax(np.abs(told - self.q)))]
            self.way = [(self.now(), self.q, np.zeros(len(self.order)))]
            self.end(FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED, f"{joint} is too far off")
        elif self.now() > self.way[-1][0]:
            self.end(FollowJointTrajectory.Result.SUCCESSFUL, "")

    def take(self, message: JointTrajectory) -> None:
        self.violate(*broken_by_trajectory(self.robot, self.order, message, self.told(self.now())[0]))
        self.hear(any(any(point.velocities) for point in message.points))
        now = self.now()
        q, v = self.told(now)
        self.way = [(now, q, v)]
        for point in message.points:
            after = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            self.way.append((now + after, np.array(point.positions), np.array(point.velocities)))

    def told(self, now: float) -> tuple[np.ndarray, np.ndarray]:
        """Where it is told to be: on a cubic between two points; at rest behind the last one."""
        if not self.way:
            return self.q, np.zeros_like(self.q)
        for (t0, q0, v0), (t1, q1, v1) in zip(self.way, self.way[1:], strict=False):
            if now < t1:
                h, s = t1 - t0, (now - t0) / (t1 - t0)
                q = (1 + 2 * s) * (1 - s) ** 2 * q0 + s * (1 - s) ** 2 * h * v0
                q = q + s * s * (3 - 2 * s) * q1 - s * s * (1 - s) * h * v1
                v = 6 * s * (1 - s) * (q1 - q0) / h + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
                return q, v
        return self.way[-1][1], np.zeros_like(self.q)

    def step(self) -> None:
        self.q, self.v = (self.q, 0.0 * self.v) if self.mode == "stuck" else self.told(self.now())
        self.watch_goal()
        if self.mode == "silent":
            return
        self.publish_state(self.q, self.v)


def main() -> None:
    words = sys.argv[1:]
    factor = slower(words)
    robot_file, *order = words
    rclpy.init()
    run(PositionRobot(RobotModel.from_file(robot_file), order, factor))


if __name__ == "__main__":
    main()
