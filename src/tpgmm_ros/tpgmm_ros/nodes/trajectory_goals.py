# SPDX-License-Identifier: Apache-2.0
"""Motions as goals of `control_msgs/FollowJointTrajectory`, each in place of the one before; what becomes of them.

Each goal ends at rest, so that a robot that gets no further one stops by itself. One goal at a time waits for its
answer. A goal that is refused, or that the controller ends before its time, is the end of the movement: the
controller stops the robot by itself, and what is sent after that would move it again unasked.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_ros.messages.classes import message_class
from tpgmm_ros.messages.motion_outputs import Motion, joint_trajectory
from tpgmm_ros.runtime.composition import guarded

TOPIC = "joint_trajectory_controller/follow_joint_trajectory"
#: A controller that takes longer to accept or refuse a goal is taken for lost, s.
ANSWER_TIMEOUT = 1.0
#: A robot that is told already to rest this near needs no further goal, rad (m).
SAME = 1e-4
#: Names of what a result may say.
ERRORS = (
    "INVALID_GOAL",
    "INVALID_JOINTS",
    "OLD_HEADER_TIMESTAMP",
    "PATH_TOLERANCE_VIOLATED",
    "GOAL_TOLERANCE_VIOLATED",
)


class TrajectoryGoals:
    """See the module.

    Parameters
    ----------
    node
        which owns the client of the action
    refused
        is called with the reason where the robot takes no more of a movement

    Raises
    ------
    ModuleNotFoundError
        control_msgs is not installed.
    """

    def __init__(self, node: Node, refused: Callable[[str], None]) -> None:
        self._node, self._refused = node, refused
        self._action = message_class("control_msgs/action/FollowJointTrajectory")
        self._tolerance = message_class("control_msgs/msg/JointTolerance")
        self._client = ActionClient(node, self._action, TOPIC)
        self._number = 0  # of the goal that counts
        self._given_up: set[int] = set()
        self._accepted: tuple[int, Any] | None = None  # the last one
        self._sent_at: float | None = None  # of a goal that waits for its answer, steady time
        self._rests_at: Array | None = None  # where the robot is told to be already

    def why_not(self) -> str:
        """Why no goal can be sent; empty where one can."""
        return "" if self._client.server_is_ready() else f"no controller offers the action {TOPIC}"

    def is_waiting(self) -> bool:
        """Whether the last goal has no answer yet; one that does not come ends the movement."""
        if self._sent_at is None:
            return False
        if time.monotonic() - self._sent_at > ANSWER_TIMEOUT:
            self._end(f"the controller has not answered a trajectory for {ANSWER_TIMEOUT:g} s")
            return False
        return True

    def send(self, motion: Motion, max_lag: float) -> None:
        """Send a motion, unless the robot is told already to rest there.

        Parameters
        ----------
        motion
            what the joints do
        max_lag
            the controller shall stop where a joint is farther from its trajectory, rad (m)
        """
        rests = not np.any(np.abs(motion.stop_q - motion.q) > SAME)
        if rests and self._rests_at is not None and np.abs(motion.q - self._rests_at).max() <= SAME:
            return
        self._rests_at = motion.stop_q if rests else None
        tolerances = [self._tolerance(name=name, position=max_lag) for name in motion.joints]
        goal = self._action.Goal(trajectory=joint_trajectory(motion), path_tolerance=tolerances)
        self._number += 1
        self._sent_at = time.monotonic()
        answer = self._client.send_goal_async(goal)
        answer.add_done_callback(guarded(self._node, partial(self._answered, self._number)))

    def destroy(self) -> None:
        """Take the client away."""
        self._number += 1
        self._client.destroy()

    def _answered(self, number: int, answer: Future) -> None:
        goal: Any = answer.result()
        if number in self._given_up and goal.accepted:  # nobody counts on it any more
            goal.cancel_goal_async()
        if number != self._number:
            self._given_up.discard(number)
            return
        self._sent_at = None
        if not goal.accepted:
            self._end("the controller refused a trajectory")
            return
        self._accepted = number, goal
        goal.get_result_async().add_done_callback(guarded(self._node, partial(self._ended, number)))

    def _ended(self, number: int, ended: Future) -> None:
        status, result = ended.result().status, ended.result().result
        if number in self._given_up:
            self._given_up.discard(number)
            return
        if status == GoalStatus.STATUS_CANCELED:  # also where another goal was on its way to take its place
            self._end("another program canceled the trajectory")
            return
        if number != self._number or (status == GoalStatus.STATUS_SUCCEEDED and result.error_code == result.SUCCESSFUL):
            return
        names = [name for name in ERRORS if getattr(result, name) == result.error_code]
        why = ", ".join([*names, *([one_line(result.error_string, 200)] if result.error_string else [])])
        self._end("the controller ended the trajectory" + (f": {why}" if why else ""))

    def _end(self, reason: str) -> None:
        """The movement is over, with the goal that goes on or waits for its answer."""
        self._given_up.add(self._number)
        if self._accepted is not None:
            number, goal = self._accepted
            self._given_up.add(number)
            if number == self._number:  # one that a refused goal was to replace comes to rest by itself
                goal.cancel_goal_async()
        self._number += 1
        self._sent_at = self._rests_at = self._accepted = None
        self._refused(reason)
