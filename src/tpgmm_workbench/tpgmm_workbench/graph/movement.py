# SPDX-License-Identifier: Apache-2.0
"""Asks the reproduction for movements: start, stop, speed, and to let go of the arm. Nothing here waits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from action_msgs.msg import GoalStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from tpgmm_core.common.text import one_line
from tpgmm_msgs.action import Reproduce

REPRODUCTION = "reproduction"


@dataclass(frozen=True, slots=True)
class RunView:
    """How far a movement is.

    Parameters
    ----------
    stage
        "idle", "asked", "running", "done", "failed" or "stopped"
    phase
        0 to 1
    words
        how it ended, or what is waited for
    """

    stage: str = "idle"
    phase: float = 0.0
    words: str = ""

    @property
    def goes_on(self) -> bool:
        """Whether the robot is asked to move."""
        return self.stage in ("asked", "running")


class MovementClient:
    """The action `reproduce`, the speed, and the life cycle of the node that serves them.

    Parameters
    ----------
    node
        asks
    say
        gets what went wrong, in words

    Attributes
    ----------
    view
        how far the movement is
    """

    def __init__(self, node: Node, say: Callable[[str], object]) -> None:
        self.view = RunView()
        self._say = say
        self._client = ActionClient(node, Reproduce, "reproduce")
        self._parameters = node.create_client(SetParametersAtomically, f"{REPRODUCTION}/set_parameters_atomically")
        self._state = node.create_client(ChangeState, f"{REPRODUCTION}/change_state")
        self._goal: ClientGoalHandle | None = None
        self._number = 0

    def start(self, model: str, duration: float = 0.0) -> None:
        """Ask for a movement.

        Parameters
        ----------
        model
            path of the model file
        duration
            s; 0: as demonstrated
        """
        if not self._client.server_is_ready():
            self.view = RunView("failed", words="no node serves the action 'reproduce': is the reproduction running?")
            return
        self._number += 1
        number = self._number
        self.view = RunView("asked", words="asked for the movement")

        def feedback(message: Any) -> None:
            if number == self._number and self.view.goes_on:
                names = ", ".join(message.feedback.frames)
                self.view = RunView("running", message.feedback.phase, f"with {names}" if names else "without a frame")

        future = self._client.send_goal_async(Reproduce.Goal(model=model, duration=duration), feedback)
        future.add_done_callback(lambda done: self._accepted(number, done))

    def _accepted(self, number: int, done: Future) -> None:
        goal = done.result()
        if goal is None or not goal.accepted:
            if number == self._number:
                self.view = RunView("failed", words="the reproduction refused the request")
            return
        if number != self._number or not self.view.goes_on:  # stopped before it was accepted
            goal.cancel_goal_async()
            return
        self._goal = goal
        goal.get_result_async().add_done_callback(lambda result: self._ended(number, result))

    def _ended(self, number: int, done: Future) -> None:
        if number != self._number:
            return
        self._goal = None
        response = done.result()
        phase = self.view.phase
        reason = one_line(response.result.reason, 500)
        if response.status == GoalStatus.STATUS_SUCCEEDED:
            error = response.result.final_position_error
            self.view = RunView("done", 1.0, reason or f"{1e3 * error:.1f} mm from the end of the movement")
        elif response.status == GoalStatus.STATUS_CANCELED or self.view.stage == "stopped":
            self.view = RunView("stopped", phase, "stopped where it was")
        else:
            self.view = RunView("failed", phase, reason)

    def stop(self) -> None:
        """Stop the movement where it is, if one goes on."""
        if self.view.goes_on:
            self.view = RunView("stopped", self.view.phase, "stopped where it was")
        if self._goal is not None:
            self._goal.cancel_goal_async()

    def set_speed(self, speed: float) -> None:
        """Of the movement; 0 is a pause, below 0 it goes back."""
        if not self._parameters.service_is_ready():
            self._say("the speed is not set: no reproduction answers")
            return
        request = SetParametersAtomically.Request(parameters=[Parameter("speed", value=speed).to_parameter_msg()])
        self._parameters.call_async(request).add_done_callback(self._told)

    def _told(self, done: Future) -> None:
        answer = done.result()
        if answer is not None and not answer.result.successful:
            self._say(f"the speed is not set: {one_line(answer.result.reason, 300)}")

    def let_go(self) -> None:
        """Ask for no more references, so that the arm can be led by hand: the controller then carries its weight alone.

        The reproduction is deactivated and activated again: it forgets the movement that it holds.
        """
        self.stop()
        if self._state.service_is_ready():
            first = self._state.call_async(_transition(Transition.TRANSITION_DEACTIVATE))
            first.add_done_callback(
                lambda _: self._state.call_async(_transition(Transition.TRANSITION_ACTIVATE)).add_done_callback(
                    self._active
                )
            )

    def _active(self, done: Future) -> None:
        answer = done.result()
        if answer is None or not answer.success:
            self._say("the reproduction did not become active again: see its log")


def _transition(number: int) -> ChangeState.Request:
    return ChangeState.Request(transition=Transition(id=number))
