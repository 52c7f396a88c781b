# SPDX-License-Identifier: Apache-2.0
"""The action ``reproduce``: one goal at a time is carried out; its client hears how far it is and how it ended."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from tpgmm_core.common.text import one_line
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.outcome import Outcome
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.runtime.composition import guarded

#: A result is kept for so long for clients whose link was down, s.
RESULT_TIMEOUT = 900


class Goals:
    """Serves the action; ``accept`` gets each goal that comes and gives it back to ``begin`` or ``finish``."""

    def __init__(self, node: Node, accept: Callable[[ServerGoalHandle], None]) -> None:
        self._node = node
        self._goal: ServerGoalHandle | None = None
        self._server = ActionServer(
            node,
            Reproduce,
            "reproduce",
            execute_callback=lambda _: None,  # goals are executed by `finish`
            handle_accepted_callback=guarded(node, accept),
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            result_timeout=RESULT_TIMEOUT,
        )

    @property
    def is_going_on(self) -> bool:
        """Whether a goal is being carried out."""
        return self._goal is not None

    @property
    def is_cancel_requested(self) -> bool:
        """Whether the client of the goal that is being carried out wants no more of it."""
        return self._goal is not None and self._goal.is_cancel_requested

    def begin(self, goal: ServerGoalHandle) -> None:
        """Carry this one out from now on."""
        self._goal = goal

    def tell(self, reference: Reference, skill: tuple[int, int, str]) -> None:
        """Feedback to the client of the goal that is being carried out, if one is.

        Parameters
        ----------
        reference
            of the present skill
        skill
            its number, from 1, how many there are, and its name
        """
        if self._goal is not None:
            feedback = Reproduce.Feedback(phase=reference.phase, frames=list(reference.frames), waits=reference.waits)
            feedback.skill, feedback.skills, feedback.skill_name = skill
            self._goal.publish_feedback(feedback)

    def end(self, outcome: Outcome) -> None:
        """Give the client of the goal that is being carried out, if one is, the outcome."""
        if self._goal is not None:
            self._node.get_logger().info(f"movement ended: {one_line(outcome.reason)}")
            finish(self._goal, outcome)
            self._goal = None

    def destroy(self) -> None:
        """Take the action away."""
        self._server.destroy()


def finish(goal: ServerGoalHandle, outcome: Outcome) -> None:
    """Give the action's client the outcome.

    A goal is "executed" only now that it is over: a coroutine that waits for the end would have the executor ask it
    over and over, at the cost of a core.
    """

    def result(goal: ServerGoalHandle) -> Reproduce.Result:
        if goal.is_cancel_requested:
            goal.canceled()
        elif outcome.success:
            goal.succeed()
        else:
            goal.abort()
        return Reproduce.Result(
            success=outcome.success,
            reason=one_line(outcome.reason),
            final_position_error=outcome.position_error,
            final_orientation_error=outcome.orientation_error,
        )

    goal.execute(result)
