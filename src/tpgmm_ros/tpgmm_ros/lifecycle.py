# SPDX-License-Identifier: Apache-2.0
"""Lifecycle nodes that no request can end."""

from __future__ import annotations

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn


class ManagedNode(LifecycleNode):
    """A lifecycle node that refuses a transition which its state does not have.

    rclpy's own lets the exception through: to activate an active controller would end its process.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._follow = self._service_change_state.callback
        self._service_change_state.callback = self._change_state

    def _change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        try:
            return self._follow(request, response)
        except rclpy_implementation.RCLError:
            _, state = self._state_machine.current_state
            asked = request.transition.label or request.transition.id
            self.get_logger().error(f"transition {asked} refused: the state '{state}' does not have it")
            response.success = False
            return response

    def start_itself(self) -> None:
        """Configure and activate without a lifecycle manager.

        Raises:
            ValueError: it refused; the reason is in its log.
        """
        for name, trigger in (("configured", self.trigger_configure), ("activated", self.trigger_activate)):
            if trigger() is not TransitionCallbackReturn.SUCCESS:
                raise ValueError(f"{self.get_name()} cannot be {name}: see above for the reason")
