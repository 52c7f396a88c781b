# SPDX-License-Identifier: Apache-2.0
"""Streams that may be faster than the node that answers them: what waits is taken together, in turn with others."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.composition import guarded
from tpgmm_ros.runtime.local_topics import receive_values, waiting_messages

#: Messages that wait at most; of more, the newest.
MOST = 64


class Batches:
    """A subscription whose callback gets all messages that wait.

    A message that finds the node idle is handed on at once. Then the executor's queue has to be worked off to its
    present end before more are handed on, together. Otherwise a node that is slower than the stream would find a newer
    message at each event of the queue, which came while the last was answered: each would be answered in full, the
    queue would grow without end, and timers, services and other topics would come later and later.

    Parameters
    ----------
    node : Node
        Subscribes.
    kind : type
        Of the messages.
    topic : str
        Their topic.
    take : callable
        Gets the messages, oldest first, at least one.
    qos : QoSProfile
        Of the subscription; its depth bounds how many can wait.
    decode : callable
        Makes of a serialised message what `take` gets; nodes of this process may publish the same as values.
    most : int
        Messages that `take` gets at most; of more that have come since the last turn, the newest. The others are
        not even read: so a flood costs a little for each message, and what is done with them once for each turn.

    Attributes
    ----------
    subscription : Subscription
        The subscription.
    """

    def __init__(
        self,
        node: Node,
        kind: type,
        topic: str,
        take: Callable[[Sequence[Any]], object],
        qos: QoSProfile,
        decode: Callable[[bytes], Any],
        most: int = MOST,
    ) -> None:
        self._node, self._take, self._decode = node, take, decode
        self._waiting: deque[bytes] = deque(maxlen=most)
        self._is_behind = False
        self._end_of_queue = guarded(node, self._work_off)
        self.subscription = node.create_subscription(kind, topic, self._come, qos, raw=True)
        receive_values(self.subscription, self._come_as_value)

    def _come(self, data: bytes) -> None:
        self._waiting.append(data)
        self._waiting.extend(waiting_messages(self.subscription))
        self._plan()

    def _come_as_value(self, value: Any) -> None:
        self._take([*self._read(), value])  # nothing waits where the sender calls

    def _plan(self) -> None:
        executor = self._node.executor
        if self._is_behind:
            return
        if messages := self._read():
            self._take(messages)
        if executor is not None:
            self._is_behind = True
            executor.create_task(self._end_of_queue)

    def _work_off(self) -> None:
        self._is_behind = False
        if self._waiting:
            self._plan()

    def _read(self) -> list[Any]:
        """All that waits, oldest first, as far as it can be read."""
        messages = []
        while self._waiting:
            try:
                messages.append(self._decode(self._waiting.popleft()))
            except RuntimeError as error:  # of rclpy, for bytes that are no such message
                text = f"a message on {self.subscription.topic_name} cannot be read: {one_line(error, 200)}"
                self._node.get_logger().error(text, throttle_duration_sec=1.0)
        return messages
