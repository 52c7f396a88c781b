# SPDX-License-Identifier: Apache-2.0
"""Lifecycle nodes that no request can end."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher

from tpgmm_core.text import one_line


class ManagedNode(LifecycleNode):
    """A lifecycle node that refuses a transition which its state does not have.

    rclpy's own lets the exception through: to activate an active controller would end its process.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._follow = self._service_change_state.callback
        self._service_change_state.callback = self._change_state
        self._own: set[int] = set()
        self._refusal = "see above for the reason"
        self._callbacks = {state: self._telling(callback) for state, callback in self._callbacks.items()}

    def _telling(self, callback: Callable[[LifecycleState], TransitionCallbackReturn]) -> Callable[..., Any]:
        """The callback of a transition, whose exceptions are in the log: rclpy keeps them to itself."""

        def call(state: LifecycleState) -> TransitionCallbackReturn:
            try:
                return callback(state)
            except Exception as error:
                self._refusal = one_line(error)
                self.get_logger().error(traceback.format_exc())
                raise

        return call

    def _change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        try:
            return self._follow(request, response)
        except rclpy_implementation.RCLError:
            _, state = self._state_machine.current_state
            asked = request.transition.label or request.transition.id
            self.get_logger().error(f"transition {asked} refused: the state '{state}' does not have it")
            response.success = False
            return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """To be called first: what is created from here on is what ``on_cleanup`` takes away."""
        self._own = {id(entity) for _, entities in self._entities() for entity in entities}
        return super().on_configure(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Topics, services and timers go as they came: configured again, the node has each of them once."""
        for destroy, entities in self._entities():
            for entity in entities:
                if id(entity) not in self._own:
                    destroy(entity)
        return super().on_cleanup(state)

    def _entities(self) -> list[tuple[Callable[[Any], object], list[Any]]]:
        return [
            (self._destroy_publisher, list(self.publishers)),
            (self.destroy_subscription, list(self.subscriptions)),
            (self.destroy_timer, list(self.timers)),
            (self.destroy_service, list(self.services)),
        ]

    def _destroy_publisher(self, publisher: Publisher) -> None:
        if isinstance(publisher, LifecyclePublisher):
            self.destroy_lifecycle_publisher(publisher)
        else:
            self.destroy_publisher(publisher)

    def refuse(self, error: Exception) -> TransitionCallbackReturn:
        """What a transition returns that cannot be made; the reason is in the log."""
        self._refusal = one_line(error)
        self.get_logger().error(self._refusal)
        return TransitionCallbackReturn.FAILURE

    def start_itself(self) -> None:
        """Configure and activate without a lifecycle manager.

        Raises:
            ValueError: it refused; the text says why.
        """
        for name, trigger in (("configured", self.trigger_configure), ("activated", self.trigger_activate)):
            if trigger() is not TransitionCallbackReturn.SUCCESS:
                raise ValueError(f"{self.get_name()} cannot be {name}: {self._refusal}")
