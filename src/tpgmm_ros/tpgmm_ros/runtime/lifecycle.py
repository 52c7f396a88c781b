# SPDX-License-Identifier: Apache-2.0
"""Lifecycle nodes that no request can end."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecyclePublisher, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.rclpy_workarounds import guard_transitions


class ManagedNode(LifecycleNode):
    """A lifecycle node that refuses a transition which its state does not have, and ends what it began."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._own: set[int] = set()
        self._refusal = "see above for the reason"
        guard_transitions(self, self._tell_error)

    def _tell_error(self, error: Exception) -> None:
        """What a transition's callback raised is in the log, with where."""
        self._refusal = one_line(error)
        self.get_logger().error("".join(traceback.format_exception(error)))

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

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """An active node ends what it does, as `on_deactivate` does: rclpy would let it go on."""
        if state.label == "active" and (result := self.on_deactivate(state)) is not TransitionCallbackReturn.SUCCESS:
            return result
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """What a transition has raised at leaves nothing behind that goes on; where that fails too, it is the end."""
        try:
            results = self.on_deactivate(state), self.on_cleanup(state)
        except Exception as error:
            self._tell_error(error)
            return TransitionCallbackReturn.FAILURE
        done = all(result is TransitionCallbackReturn.SUCCESS for result in results)
        return TransitionCallbackReturn.SUCCESS if done else TransitionCallbackReturn.FAILURE

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

        Raises
        ------
        ValueError
            it refused; the text says why.
        """
        for name, trigger in (("configured", self.trigger_configure), ("activated", self.trigger_activate)):
            if trigger() is not TransitionCallbackReturn.SUCCESS:
                raise ValueError(f"{self.get_name()} cannot be {name}: {self._refusal}")
