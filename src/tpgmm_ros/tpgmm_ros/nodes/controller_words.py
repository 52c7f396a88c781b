# SPDX-License-Identifier: Apache-2.0
"""What the robot's controller has said while a movement went on: the likely cause where the robot did not follow."""

from __future__ import annotations

from rclpy.node import Node

from tpgmm_core.common.text import one_line
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_msgs.msg import ControllerState
from tpgmm_ros.messages.qos import LATCHED

TOPIC = "controller_state"


class ControllerWords:
    """Listens to `controller_state` of a node's namespace, from now on."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._last: ControllerState | None = None
        self._worst: ControllerState | None = None
        node.create_subscription(ControllerState, TOPIC, self._take, LATCHED)

    def begin(self) -> None:
        """A movement begins: what was said before is not of it, but what was said last still holds."""
        self._worst = None

    def say(self) -> str:
        """The last that was said, and what else it did during the movement than to follow, in words."""
        if self._last is None:
            return f"no controller publishes on {TOPIC}"
        words = f"the controller says {_words(self._last)}"
        if not self._node.count_publishers(self._node.resolve_topic_name(TOPIC)):
            words = f"no controller publishes on {TOPIC} any more; it said last {_words(self._last)}"
        if self._worst is not None and self._worst.reason != self._last.reason:
            words += f", and said {_words(self._worst)} during the movement"
        return words

    def _take(self, message: ControllerState) -> None:
        self._last = message
        if message.state != ControllerMode.ACTIVE:
            self._worst = message


def _words(message: ControllerState) -> str:
    modes = {int(mode): mode.name for mode in ControllerMode}
    return f"'{modes.get(message.state, str(message.state))}: {one_line(message.reason, 300)}'"
